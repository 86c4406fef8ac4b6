const SVG = "http://www.w3.org/2000/svg";

/**
 * An element of the page; throws an error where there is none.
 * @param {string} id
 * @returns {HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no element ${id}`);
  return found;
}

/**
 * @template {Element} T
 * @param {new () => T} kind
 * @param {ParentNode} parent
 * @param {string} selector
 * @returns {T}
 */
export function select(kind, parent, selector) {
  const found = parent.querySelector(selector);
  if (!(found instanceof kind)) throw new Error(`no element ${selector}`);
  return found;
}

/**
 * @param {string} id
 * @returns {HTMLInputElement}
 */
export function inputOf(id) {
  return select(HTMLInputElement, document, `#${id}`);
}

/**
 * A new element of a drawing.
 * @param {string} kind
 * @param {Record<string, string | number>} attributes
 * @param {string} [text]
 */
export function svg(kind, attributes, text) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, String(value));
  if (text !== undefined) made.textContent = text;
  return made;
}

/**
 * A line through places, px, with a gap for each null.
 * @param {(number[] | null)[]} places
 */
export function lineThrough(places) {
  let line = "";
  let pen = "M";
  for (const place of places) {
    line += place ? `${pen}${place[0].toFixed(1)} ${place[1].toFixed(1)}` : "";
    pen = place ? "L" : "M";
  }
  return line;
}
