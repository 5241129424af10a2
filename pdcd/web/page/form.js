// A form of the fields that the server describes: it draws them in a loop and knows none by name.

import { el } from "./dom.js";

const UNSAID = "by the rig";

const named = (value) => (value === true ? "yes" : value === false ? "no" : String(value));

/** A number where the text is one; all else goes to the server as it is, which says what it takes. */
const number = (text) => (text.trim() !== "" && Number.isFinite(Number(text)) ? Number(text) : text);

async function content(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const parts = [];
  for (let at = 0; at < bytes.length; at += 32768) parts.push(String.fromCharCode(...bytes.subarray(at, at + 32768)));
  return { npy: btoa(parts.join("")), file: file.name.slice(0, 255) };
}

/** What a field is drawn by: its element, and how its value is read; undefined is what was left out. */
const drawn = {
  choice({ id, values, optional, of_goals, default: standing }) {
    const options = values.map((value, at) => el("option", { value: at, selected: value === standing }, named(value)));
    if (optional) options.unshift(el("option", { value: "" }, of_goals ? "" : UNSAID));
    const input = el("select", { id }, ...options);
    return { input, read: () => (input.value === "" ? undefined : values[Number(input.value)]) };
  },
  switch(field) {
    if (field.optional) return drawn.choice(field);
    const input = el("input", { type: "checkbox", id: field.id, checked: field.default });
    return { input, read: () => input.checked };
  },
  number({ id, values, takes, default: standing }) {
    const box = el("input", { type: "text", id, autocomplete: "off", title: takes, placeholder: takes, value: standing });
    const read = () => (box.value.trim() === "" ? undefined : number(box.value));
    if (!values.length) return { input: box, read };
    const list = el("datalist", { id: `${id}-list` }, ...values.map((value) => el("option", { value })));
    box.setAttribute("list", list.id);
    return { input: el("div", {}, box, list), read };
  },
  numbers({ id, label, count, each, takes }) {
    const box = (at) => el("input", { type: "text", id: at ? null : id, autocomplete: "off", title: takes, placeholder: each[at] ?? null, "aria-label": `${label} ${each[at] ?? at + 1}` });
    const boxes = Array.from({ length: count }, (_, at) => box(at));
    const read = () => (boxes.every(({ value }) => value.trim() === "") ? undefined : boxes.map(({ value }) => number(value)));
    return { input: el("div", { class: "many" }, ...boxes), read };
  },
  array({ id, takes }) {
    const input = el("input", { type: "file", id, accept: ".npy,.npz,.png", title: takes });
    return { input, read: () => (input.files.length ? content(input.files[0]) : undefined) };
  },
  file: (field) => drawn.array(field),
  words(field) {
    const { input, read } = drawn.text(field);
    input.placeholder = "several, with spaces between";
    return { input, read: () => read()?.split(/[\s,]+/).filter(Boolean) };
  },
  text({ id, takes, default: standing }) {
    const value = typeof standing === "string" ? standing : null;
    const input = el("input", { type: "text", id, autocomplete: "off", title: takes, value });
    return { input, read: () => (input.value.trim() === "" ? undefined : input.value) };
  },
};

/** One field with its row on the page. */
function row(field) {
  const id = `field-${field.name}`;
  const { input, read } = drawn[field.kind]({ ...field, id });
  return { ...field, read, row: el("div", { class: "field" }, el("label", { for: id }, field.label), input, el("small", {}, field.text)) };
}

/** The form of a request over what the server told, in an element of the page. */
export class RequestForm {
  #goal;
  #goals = {};
  #groups = [];
  #place;

  constructor(place) {
    this.#place = place;
  }

  /** Make all fields anew; the goal stays the chosen one. */
  describe({ goals, groups }) {
    const kept = this.#goal?.value;
    this.#goals = goals;
    this.#goal = el("select", { id: "field-goal" }, ...Object.keys(goals).map((name) => el("option", { value: name }, name)));
    this.#goal.value = kept in goals ? kept : "indirect";
    this.#goal.addEventListener("change", () => this.#show());
    this.#groups = groups.map(({ title, fields }) => ({ title, fields: fields.map(row) }));
    this.#place.replaceChildren(
      el("div", { class: "field" }, el("label", { for: "field-goal" }, "goal"), this.#goal, el("small", { id: "goal-keeps" })),
      el("div", { id: "fields-first" }),
      el("details", { id: "more" }, el("summary", {}, "More"), el("div", { id: "fields-more" })),
    );
    this.#show();
  }

  get #fields() {
    return this.#groups.flatMap(({ fields }) => fields);
  }

  #needs({ name }) {
    return this.#goals[this.#goal.value].needs.includes(name);
  }

  #takes(field) {
    return !field.of_goals || this.#needs(field) || this.#goals[this.#goal.value].may.includes(field.name);
  }

  #show() {
    this.#place.querySelector("#goal-keeps").textContent = this.#goals[this.#goal.value].keeps;
    const needed = this.#fields.filter((field) => this.#needs(field));
    const common = this.#fields.filter((field) => field.common && !needed.includes(field));
    // What the goal needs, what is asked for most; then all else, group by group.
    const first = [...needed, ...common];
    const more = this.#groups.flatMap(({ title, fields }) => {
      const rest = fields.filter((field) => this.#takes(field) && !first.includes(field));
      return rest.length ? [el("h3", {}, title), ...rest.map(({ row }) => row)] : [];
    });
    this.#place.querySelector("#fields-first").replaceChildren(...first.map(({ row }) => row));
    this.#place.querySelector("#fields-more").replaceChildren(...more);
    for (const field of this.#fields) field.row.querySelector("label").textContent = field.label + (this.#needs(field) ? " (needed)" : "");
  }

  /** The request as the fields have it. Throws an Error where one is left out that the goal needs. */
  async read() {
    const request = { goal: this.#goal.value };
    const asked = this.#fields.filter((field) => this.#takes(field));
    for (const { name, read } of asked) {
      const value = await read();
      if (value !== undefined) request[name] = value;
    }
    const missing = asked.filter((field) => this.#needs(field) && !(field.name in request));
    if (missing.length) throw new Error(`${request.goal} needs ${missing.map(({ label }) => label).join(", ")}`);
    return request;
  }
}
