// What the camera sees, live: the field's outline, and figures to focus and to expose by.

import { by, el, say } from "./dom.js";
import { news } from "./server.js";

const percent = (share, digits) => `${(100 * share).toFixed(digits)} %`;

function figures({ focus, best, mean, saturated, rate_hz: rate }) {
  return [
    ["focus", `${focus.toFixed(3)}, ${percent(best ? focus / best : 0, 0)} of the best (${best.toFixed(3)})`],
    ["mean light", `${percent(mean, 1)} of white`],
    ["saturated", `${percent(saturated, 2)} of the pixels`],
    ["rate", rate ? `${rate.toFixed(1)} pictures a second` : ""],
  ];
}

/** The card of the live view: it lasts as long as its pictures are read. */
export class LiveCard {
  #reading = null;

  /** Whether it is on. */
  get on() {
    return this.#reading !== null;
  }

  /** Begin, or end. */
  toggle() {
    if (this.on) this.#reading.abort();
    else this.#read();
  }

  async #read() {
    const reading = (this.#reading = new AbortController());
    by("live").textContent = "Stop";
    say(by("live-trouble"), "");
    const asked = { method: "POST", signal: reading.signal, body: JSON.stringify({ pattern: by("live-pattern").value }) };
    try {
      for await (const message of news("live", asked)) {
        if (message.error) say(by("live-trouble"), [message.error.message, message.error.hint].filter(Boolean).join("\n"));
        else await this.#draw(message);
      }
    } catch (trouble) {
      if (!reading.signal.aborted) say(by("live-trouble"), trouble.message);
    }
    this.#reading = null;
    by("live").textContent = "Start";
  }

  async #draw(frame) {
    const image = by("live-picture");
    const bytes = Uint8Array.from(atob(frame.jpeg), (letter) => letter.charCodeAt(0));
    URL.revokeObjectURL(image.src);
    image.src = URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
    [image.width, image.height] = frame.size_px;
    by("live-view").hidden = false;
    by("live-edge").setAttribute("points", frame.outline.map((point) => point.join(",")).join(" "));
    by("live-focus").value = frame.best ? frame.focus / frame.best : 0;
    by("live-figures").replaceChildren(...figures(frame).flatMap(([name, text]) => [el("dt", {}, name), el("dd", {}, text)]));
    await image.decode().catch(() => {});
  }
}
