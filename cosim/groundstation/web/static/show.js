// Small things that several parts of the page need.

export const get = (id) => document.getElementById(id);

/** Change a text only if it is another one: the browser lays out nothing for nothing. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A number with a fixed count of digits, and a true minus; a dash for what is not known. */
export function number(value, digits = 1) {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** An element of a drawing with its attributes, put into `parent`. */
export function draw(parent, kind, attributes = {}, text = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text) element.textContent = text;
  parent.append(element);
  return element;
}

/** An element with its attributes and children; what begins with "on" is a listener. */
export function element(kind, attributes = {}, ...children) {
  const made = document.createElement(kind);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

/** Does a text have all of the words? */
export function hasWords(text, words) {
  const low = text.toLowerCase();
  return words.toLowerCase().split(/\s+/).every((word) => low.includes(word));
}
