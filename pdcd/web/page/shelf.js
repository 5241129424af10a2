// Runs on disk and their pictures.

import { by, el, say } from "./dom.js";
import { get, picture } from "./server.js";

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
    await this.#draw(run, wanted);
    return true;
  }

  /** Whether a picture was shown yet. */
  get empty() {
    return this.#shown === null;
  }

  async #draw(run, name) {
    const image = by("picture");
    this.#shown = run.job;
    const drawn = await picture(`picture/${run.job}/${name}`);
    URL.revokeObjectURL(image.src);
    image.src = drawn;
    image.alt = `${name} of ${run.job}`;
    image.hidden = false;
    const { goal, name: called } = run.entry ?? {};
    say(by("picture-of"), [called, name, goal && `goal ${goal}`, run.job].filter(Boolean).join(", "));
  }
}

/** Open the report of a run in a tab of its own. */
async function openReport(job) {
  const { address } = await get(`ticket/${job}`);
  // Of no use to a hostile report: neither who opened it nor where from.
  window.open(address, "_blank", "noopener,noreferrer");
}

function row(run, onShow, trying) {
  const told = run.entry;
  const button = el("button", { type: "button" }, "show");
  button.addEventListener("click", () => onShow(run.job));
  const last = el("td", {}, button);
  if (run.report) {
    const report = el("button", { type: "button", class: "report" }, "report");
    report.addEventListener("click", () => trying(() => openReport(run.job)));
    last.append(report);
  }
  const state = told.kind === "preview" ? `${told.state}, quick look` : told.state;
  return el(
    "tr", {},
    el("td", {}, told.started_utc?.slice(0, 19).replace("T", " ") ?? run.job),
    el("td", {}, told.goal ?? ""),
    el("td", { class: "more" }, told.codes === null ? "" : String(told.codes)),
    el("td", { class: "more" }, run.error),
    el("td", { class: `state ${told.state} ${told.verdict ?? ""}`, title: told.reason }, [state, told.verdict].filter(Boolean).join(", ")),
    el("td", { class: "more words", title: told.note || null }, [told.name, told.tags.join(" "), told.note].filter(Boolean).join("; ")),
    el("td", { class: "more" }, told.user ?? ""),
    last,
  );
}

/** Fill the list of runs; `onShow(job)` is called for the one that is to be shown, `trying` with
 * what may go wrong. Returns them. */
export async function listRuns(onShow, trying) {
  const { runs } = await get("runs");
  by("runs-none").hidden = runs.length > 0;
  by("runs").replaceChildren(...runs.map((run) => row(run, onShow, trying)));
  return runs;
}
