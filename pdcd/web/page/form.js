// A form made from the schema of a request: what may be asked for is told by the daemon alone.

import { el, short } from "./dom.js";

const FIRST = ["codes", "error", "seconds", "name", "tags", "note"]; // shown without a click
const UNSAID = "by the rig";

/** What a value may be: its kind, whether it may be left out, and the schema of each alternative. */
function told(schema) {
  const all = schema.anyOf ?? [schema];
  const some = all.filter((each) => each.type !== "null");
  const types = some.map((each) => (each.enum ? "enum" : each.$ref ? "file" : each.prefixItems ? "tuple" : each.type));
  const optional = some.length < all.length;
  const is = (...names) => types.length === names.length && names.every((name) => types.includes(name));
  const of = (name) => some[types.indexOf(name)];
  if (types.includes("file")) return { kind: "file", optional };
  if (is("enum")) return { kind: "choice", optional, values: of("enum").enum };
  if (is("boolean", "enum")) return { kind: "choice", optional, values: [true, false, ...of("enum").enum] };
  if (is("boolean")) return optional ? { kind: "choice", optional, values: [true, false] } : { kind: "check" };
  if (is("integer") || is("number")) return { kind: "number", optional, each: some[0] };
  if (is("integer", "enum")) return { kind: "word", optional, each: of("integer"), values: of("enum").enum };
  if (is("tuple")) return { kind: "tuple", optional, items: some[0].prefixItems };
  if (is("array") && some[0].items?.type === "string") return { kind: "list", optional };
  if (is("string")) return { kind: "text", optional, each: some[0] };
  return { kind: "json", optional };
}

const named = (value) => (value === true ? "yes" : value === false ? "no" : String(value));
const label = (name) => name.replaceAll("_", " ");

function range(schema) {
  const { minimum, maximum, exclusiveMinimum: over, exclusiveMaximum: below, multipleOf } = schema;
  const low = over !== undefined ? `over ${short(over)}` : minimum !== undefined ? short(minimum) : "";
  const high = below !== undefined ? `below ${short(below)}` : maximum !== undefined ? `to ${short(maximum)}` : "";
  const ends = [low, high].filter(Boolean).join(over !== undefined || below !== undefined ? ", " : " ");
  return [multipleOf && `multiple of ${multipleOf}`, ends].filter(Boolean).join(", ");
}

function number(schema, text, name) {
  const value = Number(text);
  const wrong =
    text.trim() === "" ||
    !Number.isFinite(value) ||
    (schema.type === "integer" && !Number.isInteger(value)) ||
    value < (schema.minimum ?? -Infinity) ||
    value > (schema.maximum ?? Infinity) ||
    value <= (schema.exclusiveMinimum ?? -Infinity) ||
    value >= (schema.exclusiveMaximum ?? Infinity) ||
    (schema.multipleOf && value % schema.multipleOf !== 0);
  if (wrong) throw new Error(`${label(name)}: ${schema.type === "integer" ? "a whole number" : "a number"}, ${range(schema)}`);
  return value;
}

async function content(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const parts = [];
  for (let at = 0; at < bytes.length; at += 32768) parts.push(String.fromCharCode(...bytes.subarray(at, at + 32768)));
  return { npy: btoa(parts.join("")), file: file.name.slice(0, 255) };
}

/** One field: its row on the page, and how its value is read; undefined is what was left out. */
function field(name, schema, words, unsaid) {
  const what = told(schema);
  const id = `field-${name}`;
  const hint = (each) => ({
    title: range(each) || null,
    placeholder: what.optional && what.kind !== "tuple" ? [unsaid, range(each)].filter(Boolean).join("; ") : null,
  });
  const numeric = (each, more) =>
    el("input", { type: "text", inputmode: each.type === "integer" ? "numeric" : "decimal", autocomplete: "off", ...hint(each), ...more });
  const standing = schema.default ?? null;
  let input, read;
  if (what.kind === "choice") {
    const options = what.values.map((value, at) => el("option", { value: at, selected: value === standing }, named(value)));
    if (what.optional) options.unshift(el("option", { value: "" }, unsaid));
    input = el("select", { id }, ...options);
    read = () => (input.value === "" ? undefined : what.values[Number(input.value)]);
  } else if (what.kind === "check") {
    input = el("input", { type: "checkbox", id, checked: standing === true });
    read = () => input.checked;
  } else if (what.kind === "number") {
    input = numeric(what.each, { id, value: standing });
    read = () => (input.value.trim() === "" ? undefined : number(what.each, input.value, name));
  } else if (what.kind === "word") {
    const list = el("datalist", { id: `${id}-list` }, ...what.values.map((value) => el("option", { value })));
    const box = numeric(what.each, { id, list: list.id, inputmode: null });
    input = el("div", {}, box, list);
    box.title = `${what.values.join(", ")}, or ${range(what.each)}`;
    read = () => {
      const text = box.value.trim();
      return text === "" ? undefined : what.values.includes(text) ? text : number(what.each, text, name);
    };
  } else if (what.kind === "tuple") {
    const boxes = what.items.map((each, at) => numeric(each, { id: at ? null : id, "aria-label": `${label(name)} ${at + 1}` }));
    input = el("div", { class: "many" }, ...boxes);
    read = () =>
      boxes.every((box) => box.value.trim() === "") ? undefined : boxes.map((box, at) => number(what.items[at], box.value, name));
  } else if (what.kind === "file") {
    input = el("input", { type: "file", id, accept: ".npy,.npz,.png" });
    read = () => (input.files.length ? content(input.files[0]) : undefined);
  } else {
    const many = what.kind === "list" ? "several, with spaces between" : null;
    input = el("input", { type: "text", id, autocomplete: "off", maxlength: what.each?.maxLength, value: many ? null : standing, placeholder: many });
    const parse = {
      list: (text) => text.split(/[\s,]+/).filter(Boolean),
      json: (text) => JSON.parse(text),
      text: (text) => text,
    }[what.kind];
    read = () => (input.value.trim() === "" ? undefined : parse(input.value));
  }
  const row = el("div", { class: "field" }, el("label", { for: id }, label(name)), input);
  if (words) row.append(el("small", {}, words));
  return { name, row, read };
}

/** The form of a request over what `rig.describe` told, in an element of the page. */
export class RequestForm {
  #goal;
  #fields = [];
  #goals = {};
  #ofGoals = new Set();
  #place;

  constructor(place) {
    this.#place = place;
  }

  /** Make all fields anew; the goal stays the chosen one. */
  describe({ schema, goals, arrays }) {
    const kept = this.#goal?.value;
    const properties = schema.request.properties;
    const possible = new Set(properties.goal.enum);
    this.#goals = Object.fromEntries(Object.entries(goals).filter(([name]) => possible.has(name)));
    this.#ofGoals = new Set(Object.values(goals).flatMap((goal) => [...goal.needs, ...goal.may]));
    this.#goal = el("select", { id: "field-goal" }, ...Object.keys(this.#goals).map((name) => el("option", { value: name }, name)));
    this.#goal.value = kept in this.#goals ? kept : "indirect" in this.#goals ? "indirect" : this.#goal.value;
    this.#goal.addEventListener("change", () => this.#show());
    this.#fields = Object.entries(properties)
      .filter(([name]) => name !== "goal")
      .map(([name, each]) => field(name, each, arrays[name], this.#ofGoals.has(name) ? "" : UNSAID));
    const keeps = el("small", { id: "goal-keeps" });
    this.#place.replaceChildren(
      el("div", { class: "field" }, el("label", { for: "field-goal" }, "goal"), this.#goal, keeps),
      el("div", { id: "fields-first" }),
      el("details", { id: "more" }, el("summary", {}, "More"), el("div", { id: "fields-more" })),
    );
    this.#show();
  }

  #takes(name) {
    const goal = this.#goals[this.#goal.value];
    return !this.#ofGoals.has(name) || goal.needs.includes(name) || goal.may.includes(name);
  }

  #show() {
    const goal = this.#goals[this.#goal.value];
    this.#place.querySelector("#goal-keeps").textContent = goal.keeps;
    // What the goal needs, what is asked for most, then all else, what the goal may have before it.
    const rank = ({ name }) => (goal.needs.includes(name) ? 0 : FIRST.includes(name) ? 1 : goal.may.includes(name) ? 2 : 3);
    const shown = this.#fields.filter(({ name }) => this.#takes(name)).sort((a, b) => rank(a) - rank(b));
    const rows = (first) => shown.filter((each) => rank(each) < 2 === first).map(({ row }) => row);
    this.#place.querySelector("#fields-first").replaceChildren(...rows(true));
    this.#place.querySelector("#fields-more").replaceChildren(...rows(false));
    for (const { name, row } of shown) {
      row.querySelector("label").textContent = label(name) + (goal.needs.includes(name) ? " (needed)" : "");
    }
  }

  /** The request as the fields have it. Throws an Error that says which of them is wrong. */
  async read() {
    const request = { goal: this.#goal.value };
    for (const { name, read } of this.#fields) {
      const value = this.#takes(name) ? await read() : undefined;
      if (value !== undefined) request[name] = value;
    }
    const missing = this.#goals[request.goal].needs.filter((name) => !(name in request));
    if (missing.length) throw new Error(`${request.goal} needs ${missing.map(label).join(", ")}`);
    return request;
  }
}
