// On every page: sorts, folds and exports tables, explains their headings, colours lines. Choices are in the address.
"use strict";

/** An element. Functions among the attributes become event listeners; children may be text. */
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined) continue;
    if (typeof value === "function") made.addEventListener(name, value);
    else made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** The choices in the address: #key=value&... A fragment without "=" names a place on the page. */
const address = {
  read: () => new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : ""),
  write(changes) {
    const wanted = address.read();
    for (const [key, value] of Object.entries(changes)) value ? wanted.set(key, value) : wanted.delete(key);
    history.replaceState(null, "", wanted.size || location.hash.includes("=") ? `#${wanted}` : location.href);
  },
};

const SHOWN = 100; // rows, before the reader asks for all
const collator = new Intl.Collator("en", { numeric: true });
const plain = (node) => node.textContent.trim().replace(/\s+/g, " ");
const keyOf = (cell) => {
  const value = cell.dataset.value ?? plain(cell);
  return value === "" || value === "\u2013" ? null : Number.isNaN(Number(value)) ? value : Number(value);
};

/** Makes a table sortable: best first, then worst first. Rows of `data-group` bodies stay below, folded. */
function enhance(table) {
  const heads = [...table.tHead.rows[0].cells];
  const title = (head) => plain(head.querySelector("button"));
  const prefix = table.id ? `${table.id}-` : "";
  const state = { sorted: null, worst: false, all: false };
  const said = element("span", { role: "status" });
  const more = element("button", { type: "button", hidden: "", click: () => { state.all = true; limit(); } });

  /** Shows the first rows, and the others a frame later if the reader asked for all: what is best is seen at once. */
  function limit() {
    const rows = [...table.tBodies].filter((body) => !body.dataset.group).flatMap((body) => [...body.rows]);
    rows.forEach((row, k) => { row.hidden = k >= SHOWN; });
    if (state.all) requestAnimationFrame(() => setTimeout(() => rows.forEach((row) => { row.hidden = false; })));
    more.hidden = state.all || rows.length <= SHOWN;
    more.textContent = `Show all ${rows.length} rows`;
  }

  function sort(head, worst) {
    const column = heads.indexOf(head);
    const higher = head.dataset.sort === "higher";
    const turn = higher === worst ? 1 : -1;
    for (const body of table.tBodies) {
      const rows = [...body.rows].filter((row) => !row.classList.contains("group"));
      const keyed = rows.map((row) => [keyOf(row.cells[column]), row]);
      keyed.sort(([a], [b]) => {
        if (a === null || b === null) return (a === null) - (b === null);
        if (typeof a === "number" && typeof b === "number") return turn * (a - b);
        return turn * collator.compare(String(a), String(b));
      });
      body.append(...keyed.map(([, row]) => row));
    }
    for (const each of heads) each.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", turn === 1 ? "ascending" : "descending");
    Object.assign(state, { sorted: head, worst });
    const order = head.dataset.sort === "none" || head.dataset.sort === undefined ? "smallest" : "best";
    said.textContent = `Sorted by ${title(head).replace(/ [\u2191\u2193]$/, "")}, ${worst ? (order === "best" ? "worst" : "largest") : order} first.`;
    limit();
  }

  for (const head of heads) {
    head.querySelector("button")?.addEventListener("click", () => {
      const worst = state.sorted === head && !state.worst;
      sort(head, worst);
      address.write({ [`${prefix}sort`]: `${heads.indexOf(head)}${worst ? "-worst" : ""}` });
    });
  }

  for (const body of table.tBodies) {
    const name = body.dataset.group;
    if (!name) continue;
    const key = `${prefix}${name.replaceAll(" ", "-")}`;
    const button = element("button", { type: "button", "aria-expanded": "false" });
    const fold = (open) => {
      button.setAttribute("aria-expanded", String(open));
      for (const row of body.rows) if (!row.classList.contains("group")) row.hidden = !open;
    };
    button.addEventListener("click", () => {
      const open = button.getAttribute("aria-expanded") === "false";
      fold(open);
      address.write({ [key]: open ? "open" : "" });
    });
    button.textContent = `${name} (${body.rows.length})`;
    body.prepend(element("tr", { class: "group" }, element("th", { scope: "rowgroup", colspan: String(heads.length) }, button)));
    fold(address.read().get(key) === "open");
  }

  /** Headings and visible rows, as text. */
  function shown() {
    const rows = [...table.tBodies].flatMap((body) => [...body.rows]).filter((row) => !row.hidden && !row.classList.contains("group"));
    const text = (cell) => {
      const copy = cell.cloneNode(true);
      for (const extra of copy.querySelectorAll("sup, .unseen")) extra.remove();
      return plain(copy).replaceAll("\u2212", "-").replaceAll("\u2013", "-");
    };
    return [heads.map(title), ...rows.map((row) => [...row.cells].map(text))];
  }

  const save = (ending, type, write) => element("button", { type: "button", click: () => {
    const url = URL.createObjectURL(new Blob([write(shown())], { type }));
    element("a", { href: url, download: `${(table.dataset.name || "table").replace(/[^\w.-]+/g, "-")}.${ending}` }).click();
    URL.revokeObjectURL(url);
  } }, ending === "csv" ? "CSV" : "LaTeX");
  const tools = element("div", { class: "tools" }, more, save("csv", "text/csv", asCsv), save("tex", "text/x-tex", asLatex), said);
  (table.closest(".scroll") ?? table).after(tools);

  const [wanted, worst] = (address.read().get(`${prefix}sort`) ?? "").split("-");
  if (wanted && heads[Number(wanted)]?.querySelector("button")) sort(heads[Number(wanted)], worst === "worst");
  else limit();
  return () => tools.remove();
}

const asCsv = (lines) => `${lines.map((line) => line.map((text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text)).join(",")).join("\n")}\n`;

function asLatex(lines) {
  const special = { "\\": "\\textbackslash{}", "^": "\\textasciicircum{}", "~": "\\textasciitilde{}", "\u2191": "$\\uparrow$", "\u2193": "$\\downarrow$" };
  const escaped = (text) => text.replace(/[\\^~&%$#_{}\u2191\u2193]/g, (found) => special[found] ?? `\\${found}`).replace(/^-(?=\d)/, "$-$");
  const [head, ...rows] = lines.map((line) => `${line.map(escaped).join(" & ")} \\\\`);
  return ["\\begin{tabular}{" + "l".repeat(lines[0].length) + "}", "\\hline", head, "\\hline", ...rows, "\\hline", "\\end{tabular}", ""].join("\n");
}

/** What a heading means: on hover, focus and tap, from the page's definitions, with a link to them. */
function explainHeadings() {
  const tip = element("div", { id: "tip", role: "tooltip", hidden: "" });
  document.body.append(tip);
  let leaving = 0;
  const hide = () => { tip.hidden = true; };
  const later = () => { leaving = setTimeout(hide, 200); };
  const show = ({ target }) => {
    const heading = target.closest?.("[data-def]");
    if (!heading) return;
    const meaning = document.getElementById(`def-${heading.dataset.def}`);
    if (!meaning) return;
    clearTimeout(leaving);
    tip.replaceChildren(`${plain(meaning.firstElementChild)} `, element("a", { href: `#def-${heading.dataset.def}` }, "Definition"));
    tip.hidden = false;
    const at = heading.getBoundingClientRect();
    tip.style.left = `${Math.max(8, Math.min(at.left, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${at.bottom + 4}px`;
  };
  document.addEventListener("pointerover", show);
  document.addEventListener("focusin", show);
  document.addEventListener("pointerout", ({ target }) => { if (target.closest?.("[data-def]")) later(); });
  document.addEventListener("focusout", later);
  document.addEventListener("scroll", hide, true);
  document.addEventListener("keydown", ({ key }) => { if (key === "Escape") hide(); });
  tip.addEventListener("pointerenter", () => clearTimeout(leaving));
  tip.addEventListener("pointerleave", later);
  tip.addEventListener("focusin", () => clearTimeout(leaving));
}

/** Chips colour and grey the lines of their figure. */
document.addEventListener("click", ({ target }) => {
  const chip = target.closest?.(".chip[aria-pressed]");
  if (!chip) return;
  const on = chip.getAttribute("aria-pressed") === "false";
  chip.setAttribute("aria-pressed", String(on));
  for (const line of chip.closest("figure").querySelectorAll("g.line")) {
    if (line.dataset.line === chip.dataset.line) {
      line.classList.toggle("on", on);
      line.parentNode.append(line);
    }
  }
});

for (const table of document.querySelectorAll("table[data-table]")) enhance(table);
explainHeadings();
