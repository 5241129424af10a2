// Runs on disk and their pictures.

import { by, el, say } from "./dom.js";
import { get } from "./server.js";

let looks = 0;

/** The card of pictures: those of one run, one of them shown. */
export class PictureCard {
  #shown = null;

  /** Show a run's pictures, the one of its goal first. */
  async show(job, name = null) {
    const run = await get(`run/${job}`);
    if (!run.pictures.length) return false;
    const wanted = name && run.pictures.includes(name) ? name : run.pictures[0];
    by("picture-names").replaceChildren(
      ...run.pictures.map((each) => {
        const button = el("button", { type: "button", "aria-pressed": String(each === wanted) }, each);
        button.addEventListener("click", () => this.show(job, each));
        return button;
      }),
    );
    this.#draw(run, wanted);
    return true;
  }

  /** Whether a picture was shown yet. */
  get empty() {
    return this.#shown === null;
  }

  #draw(run, name) {
    const image = by("picture");
    this.#shown = run.job;
    looks += 1; // a picture of a run that goes on has the same name and is another one
    image.src = `picture/${run.job}/${name}/${looks}`;
    image.alt = `${name} of ${run.job}`;
    image.hidden = false;
    say(by("picture-of"), [name, run.goal && `goal ${run.goal}`, run.job].filter(Boolean).join(", "));
  }
}

/** Fill the list of runs; `onShow(job)` is called for the one that is to be shown. Returns them. */
export async function listRuns(onShow) {
  const { runs } = await get("runs");
  by("runs-none").hidden = runs.length > 0;
  by("runs").replaceChildren(
    ...runs.map((run) => {
      const button = el("button", { type: "button" }, "show");
      button.addEventListener("click", () => onShow(run.job));
      const last = el("td", {}, button);
      if (run.report) {
        last.append(el("a", { href: `report/${run.job}`, target: "_blank", rel: "noopener" }, "report"));
      }
      const time = run.started_utc?.slice(0, 19).replace("T", " ") ?? run.job;
      return el(
        "tr", {},
        el("td", {}, time), el("td", {}, run.goal ?? ""), el("td", { class: run.state }, run.state), el("td", { class: "by" }, run.user ?? ""), last,
      );
    }),
  );
  return runs;
}
