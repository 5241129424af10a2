// The depth of fine stripes, photo by photo, while somebody turns a ring.

import { by, el, short } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 28, RIGHT = 312, TOP = 8, BOTTOM = 100, MOST = 1.3;

function drawn(tag, attributes, text) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, String(value));
  if (text !== undefined) made.textContent = text;
  return made;
}

/** The card that shows how sharp it is. */
export class FocusCard {
  #job = null;
  #seen = []; // of each panel: its name, and the depths of its stripes

  /** One event of any job. */
  hear(event) {
    if (event.type === "step_begun" && event.step === "focus") {
      this.#job = event.job;
      this.#seen = [];
      by("focus-found").replaceChildren();
      by("focus-now").textContent = "takes the first photo";
    }
    if (event.job !== this.#job) return;
    const panel = event.type === "armed" && /^focus-([a-z]+)-1$/.exec(event.shot);
    if (panel) this.#seen.push({ panel: panel[1], depths: [] });
    if (event.type === "attention" && typeof event.now === "number") {
      this.#seen.at(-1)?.depths.push(event.now);
      by("focus-now").textContent = `now ${event.now.toFixed(3)}, best so far ${event.best.toFixed(3)}`;
      this.#draw();
    }
    if (event.type === "step_ended" && event.step === "focus") {
      const found = event.figures.map((each) => `${each.name} ${each.value === null ? "unknown" : short(each.value)}: ${each.verdict} (${each.limit})`);
      by("focus-found").replaceChildren(...[...found, ...event.advice].map((text) => el("li", {}, text)));
      by("focus-now").textContent = `focus: ${event.verdict}`;
    }
    if (["failed", "cancelled"].includes(event.type)) by("focus-now").textContent = event.type;
  }

  #draw() {
    const chart = by("focus-chart");
    const many = Math.max(2, ...this.#seen.map(({ depths }) => depths.length));
    const x = (at) => LEFT + ((RIGHT - LEFT) * at) / (many - 1);
    const y = (depth) => BOTTOM - ((BOTTOM - TOP) * Math.min(depth, MOST)) / MOST;
    const line = ({ panel, depths }) => [
      drawn("polyline", { class: `line ${panel}`, points: depths.map((depth, at) => `${x(at)},${y(depth)}`).join(" ") }),
      ...depths.map((depth, at) => drawn("circle", { class: panel, cx: x(at), cy: y(depth), r: 2.5 })),
    ];
    const names = this.#seen.map(({ panel }, at) => drawn("text", { class: panel, x: RIGHT - 60 * (this.#seen.length - at), y: 114 }, panel));
    chart.removeAttribute("hidden"); // SVG has no property of that name
    chart.replaceChildren(
      drawn("path", { class: "axis", d: `M${LEFT} ${TOP}V${BOTTOM}H${RIGHT}` }),
      ...[0, 0.5, 1].map((depth) => drawn("text", { x: 6, y: y(depth) + 3 }, depth)),
      drawn("text", { x: LEFT, y: 114 }, "depth, photo by photo"),
      ...names,
      ...this.#seen.flatMap(line),
    );
  }
}
