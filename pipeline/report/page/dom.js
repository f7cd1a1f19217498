// Making elements: data becomes text nodes and attributes, never markup.

const DATA = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);

/** Return a new element with attributes, listeners (functions) and children. */
function element(name, attributes = {}, ...children) {
  const svg = ["svg", "rect", "line", "text", "title", "g"].includes(name);
  const made = svg
    ? document.createElementNS("http://www.w3.org/2000/svg", name)
    : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(key, value);
    else if (value !== null && value !== false) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** Return a table; a cell is a value, or [value, class]. */
function table(caption, headings, rows) {
  const parts = (cell) => (Array.isArray(cell) ? cell : [cell, null]);
  const row = (kind, cells) =>
    element(
      "tr", {},
      ...cells.map(parts).map(([value, style]) =>
        element(kind, { class: style, scope: kind === "th" ? "col" : null }, value),
      ),
    );
  return element(
    "div", { class: "scroll", tabindex: 0, role: "region", "aria-label": caption },
    element(
      "table", {},
      element("caption", {}, caption),
      element("thead", {}, row("th", headings)),
      element("tbody", {}, ...rows.map((cells) => row("td", cells))),
    ),
  );
}

const grouped = (number) => number.toLocaleString("en-US");
const plural = (count, noun) => `${grouped(count)} ${noun}${count === 1 ? "" : "s"}`;
const percent = (share, digits = 1) => `${(100 * share).toFixed(digits)}%`;
const notice = (...children) => element("p", { class: "notice" }, ...children);
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;
const code = (text) => element("code", {}, text);

/** Fill a <select> with [value, label] pairs. */
function fill(select, options) {
  select.replaceChildren(...options.map(([value, label]) => element("option", { value }, label)));
}

/** Copy a text to the clipboard, and report in `status` whether it worked. */
async function copyText(text, status) {
  try {
    await navigator.clipboard.writeText(text);
    status.textContent = "Copied.";
  } catch {
    status.textContent = "The browser does not allow copying. The column info has the text, too.";
  }
}
