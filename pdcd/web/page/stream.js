// Pictures by the plan of the form, again and again: rate, latency, error, and a run when wanted.

import { by, el, say } from "./dom.js";
import { news, post } from "./server.js";

const percent = (share) => `${Number((100 * share).toPrecision(2))} %`;

function figures({ goal, rate_hz: rate, latency_s: latency, rms_sigma: sigma, sigma_kind: kind, over, lost, late }) {
  const codes = kind === "sensor" ? " of the sensor alone, as too few photos tell of the codes" : "";
  return [
    ["goal", `${goal}, ${over} ${over === 1 ? "photo" : "photos"} a picture`],
    ["rate", rate ? `${rate.toFixed(1)} pictures a second` : ""],
    ["latency", `${(1000 * latency).toFixed(0)} ms`],
    ["sigma", sigma === null ? "not known" : percent(sigma) + codes],
    ["spoilt", lost ? `${lost} photos so far` : ""],
    ["late", late ? `${late} refreshes, without harm` : ""],
  ].filter(([, text]) => text);
}

/** The card of a stream: it lasts as long as its pictures are read. */
export class StreamCard {
  #reading = null;
  #job = null;
  #recording = false;
  #first = true;

  /** Whether it is on. */
  get on() {
    return this.#reading !== null;
  }

  /** Begin with that request, or end. */
  toggle(request) {
    if (this.on) this.#reading.abort();
    else this.#read(request);
  }

  /** Have a run made of the newest photos. */
  async record() {
    this.#recording = by("record").disabled = true;
    say(by("stream-said"), "making a run of the newest photos");
    try {
      const { state, folder, error } = await post("record", { job: this.#job });
      say(by("stream-said"), state === "done" ? `recorded: ${folder}` : `no run was made: ${error.message}`);
    } catch (trouble) {
      say(by("stream-said"), trouble.message);
    }
    this.#recording = false;
    by("record").disabled = !this.on;
  }

  async #read(request) {
    const reading = (this.#reading = new AbortController());
    by("stream").textContent = "Stop";
    say(by("stream-trouble"), "");
    this.#first = true;
    say(by("stream-said"), "the first photos are being taken");
    try {
      for await (const message of news("stream", { method: "POST", signal: reading.signal, body: JSON.stringify(request) })) {
        if (message.error) say(by("stream-trouble"), [message.error.message, message.error.hint].filter(Boolean).join("\n"));
        else await this.#draw(message);
      }
    } catch (trouble) {
      if (!reading.signal.aborted) say(by("stream-trouble"), trouble.message);
    }
    this.#reading = null;
    by("stream").textContent = "Start";
    by("record").disabled = true;
  }

  async #draw(frame) {
    if (frame.job) {
      this.#job = frame.job;
      return;
    }
    if (this.#first) say(by("stream-said"), "");
    this.#first = false;
    by("record").disabled = this.#recording;
    const image = by("stream-picture");
    // What is shown was no good photo any more: it is not passed for one.
    image.classList.toggle("stale", Boolean(frame.spoilt));
    say(by("stream-trouble"), frame.spoilt ? `a photo was spoilt: ${frame.spoilt}` : "");
    if (frame.spoilt || !frame.jpeg) return;
    by("stream-view").hidden = false;
    by("stream-figures").replaceChildren(...figures(frame).flatMap(([name, text]) => [el("dt", {}, name), el("dd", {}, text)]));
    const bytes = Uint8Array.from(atob(frame.jpeg), (letter) => letter.charCodeAt(0));
    URL.revokeObjectURL(image.src);
    image.src = URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
    [image.width, image.height] = frame.size_px;
    await image.decode().catch(() => {});
  }
}
