// What the site's pages do by themselves: tables that sort and filter, replays that open in place, context of what was found.
"use strict";

// --- tables ---------------------------------------------------------------------------------------------------------

const FEW = 3; // rows, up to which a table is seen at once
const MANY = 12; // rows, from which a table can be filtered
const WIDE = 8; // columns, from which a table scrolls instead of squeezing its cells

/** The first number of a cell, or its words: what it is sorted by. */
function sortKey(cell) {
  const text = cell.textContent.trim().replace("−", "-");
  const number = text.replace(/(\d)[ ,](?=\d{3}\b)/g, "$1").match(/^[^\w.-]*(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)/);
  return number ? Number(number[1]) : text.toLowerCase();
}

function compare(a, b) {
  if (typeof a === typeof b) return typeof a === "number" ? a - b : a.localeCompare(b);
  return typeof a === "number" ? -1 : 1; // numbers before words
}

function sortBy(table, column, head) {
  const upwards = head.getAttribute("aria-sort") !== "ascending";
  for (const each of table.tHead.rows[0].cells) each.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", upwards ? "ascending" : "descending");
  const rows = [...table.tBodies[0].rows].map((row) => [sortKey(row.cells[column]), row]);
  rows.sort((a, b) => (upwards ? 1 : -1) * compare(a[0], b[0]));
  table.tBodies[0].append(...rows.map(([, row]) => row));
}

function makeSortable(table) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "sort";
    button.title = "Sort by this column";
    button.append(...head.childNodes);
    button.addEventListener("click", () => sortBy(table, column, head));
    head.append(button);
  });
}

function makeFilter(table) {
  const field = document.createElement("input");
  field.type = "search";
  field.className = "filter";
  field.placeholder = `Filter ${table.tBodies[0].rows.length} rows`;
  field.setAttribute("aria-label", "Show the rows that contain these words");
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/);
    for (const row of table.tBodies[0].rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  });
  const place = table.closest(".table-wrapper") ?? table;
  place.before(field);
}

for (const table of document.querySelectorAll("article table")) {
  const rows = table.tHead && table.tBodies[0] ? table.tBodies[0].rows.length : 0;
  if (rows > FEW) makeSortable(table);
  if (rows > MANY) makeFilter(table);
  if (rows && table.tHead.rows[0].cells.length >= WIDE) table.classList.add("wide");
}

// --- pages of flights in place ----------------------------------------------------------------------------------------

for (const picture of document.querySelectorAll("a > img.live")) {
  const link = picture.parentElement;
  const button = document.createElement("button");
  button.type = "button";
  button.className = "play";
  button.textContent = "▶ Open it here";
  button.addEventListener("click", () => {
    const frame = document.createElement("iframe");
    frame.src = `${link.href}#replay-card`; // where the page has one
    frame.title = picture.alt;
    frame.className = "live";
    link.after(frame);
    link.hidden = true;
    button.remove();
  });
  link.after(button);
}

// --- context of what was found -----------------------------------------------------------------------------------------

/** Some words about the first of the words that the page's text has. */
function contextOf(text, words) {
  const low = text.toLowerCase();
  const at = words.map((word) => low.indexOf(word)).filter((place) => place >= 0);
  if (!at.length) return null;
  const before = Math.max(0, Math.min(...at) - 90);
  const start = before ? text.indexOf(" ", before) + 1 : 0;
  const end = (text.indexOf(" ", start + 230) + 1 || text.length + 1) - 1;
  const shown = document.createElement("p");
  shown.className = "context";
  const part = (start ? "… " : "") + text.slice(start, end) + (end < text.length ? " …" : "");
  const parts = part.split(new RegExp(`(${words.map((word) => word.replace(/\W/g, "\\$&")).join("|")})`, "i"));
  parts.forEach((each, n) => {
    const piece = document.createElement(n % 2 ? "mark" : "span");
    piece.textContent = each;
    shown.append(piece);
  });
  return shown;
}

const results = document.getElementById("search-results");
if (results && window.siteTexts) {
  const words = (new URLSearchParams(location.search).get("q") ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  const root = new URL(document.documentElement.dataset.content_root ?? "./", location.href).href;
  const add = (item) => {
    const link = item.querySelector("a");
    if (!link || !words.length || item.querySelector(".context")) return;
    const name = link.href.slice(root.length).replace(/\.html.*$/, "");
    const shown = contextOf(window.siteTexts[name] ?? "", words);
    if (shown) item.append(shown);
  };
  new MutationObserver(() => results.querySelectorAll("li").forEach(add)).observe(results, {
    childList: true,
    subtree: true,
  });
}
