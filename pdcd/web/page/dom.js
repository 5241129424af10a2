// Small helpers. Texts of the daemon become text nodes and nothing else.

/** The element with that id. */
export const by = (id) => document.getElementById(id);

/** A new element; children are elements or texts. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, String(value));
  }
  made.append(...children);
  return made;
}

/** Show a text in an element, or hide it where there is none. */
export function say(element, text) {
  element.textContent = text ?? "";
  element.hidden = !text;
}

/** A number as people read it: of three digits, unless it is whole. */
export const short = (number) => String(Number.isInteger(number) ? number : Number(Number(number).toPrecision(3)));
