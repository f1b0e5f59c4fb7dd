// Shared by both pages: the board's data, elements, numbers, and loading the scripts of policies on demand.
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

const number = (value, digits = 3) =>
  value === null || value === undefined ? "\u2013" : value.toFixed(digits).replace("-", "\u2212");

const METRICS = BOARD.columns.map(([name]) => name);
const HEADINGS = Object.fromEntries(BOARD.columns);

/** The rows of the board as objects, each with its policy and table. */
const rows = BOARD.rows.map((row) => {
  const policy = BOARD.policies[row[0]];
  return {
    policy, table: BOARD.tables[policy.table], explainer: row[1], control: row[2] === 1, rank: row[3],
    rankInterval: row[4], tie: row[5], submitter: row[6], verification: row[7], id: row[8],
    animated: row[9] === 1, why: BOARD.reasons[row[10]], file: row[11],
    metrics: Object.fromEntries(METRICS.map((name, k) => [name, row[12][k]])), variantsTried: row[13], fresh: row[14],
  };
});

/** The heading of a metric without its arrow. */
const plainHeading = (name) => (HEADINGS[name] ?? name.replaceAll("_", " ")).replace(/ [\u2191\u2193]$/, "");

const describeProtocol = (key) => {
  const { id, episodes, timesteps } = BOARD.protocols[key];
  return `${id}, ${episodes} episodes, ${timesteps === null ? "every timestep" : `${timesteps} timesteps of each`}`;
};

const letter = (group) => {
  let text = "";
  for (let k = group; k > 0; k = Math.floor((k - 1) / 26)) text = String.fromCharCode(97 + ((k - 1) % 26)) + text;
  return text;
};

/** The rank, with its interval and the letter of the tie group if it has them. */
function placeNode(rank, interval, tie) {
  if (rank === null) return element("span", { class: "none" }, "\u2013");
  const text = interval === null ? "" : interval[0] === interval[1] ? ` [${interval[0]}]` : ` [${interval[0]}\u2013${interval[1]}]`;
  return element("span", {}, String(rank), element("small", {}, text), element("sup", { class: "tie", title: "tie group" }, letter(tie)));
}

/** A value with its interval as text (in narrow cells for screen readers only) and as a bar over `domain`. */
function intervalNode(value, low, high, domain, narrow = false, digits = 3) {
  if (value === null) return element("span", { class: "none" }, "NaN");
  const known = low !== null && low !== undefined;
  const interval = known ? ` [${number(low, digits)}, ${number(high, digits)}]` : "";
  const node = element("span", { class: narrow ? "value narrow" : "value", title: narrow ? interval.trim() : null }, number(value, digits));
  if (known) node.append(element("small", { class: narrow ? "unseen" : "" }, interval));
  if (domain) {
    const at = (x) => 100 * Math.min(1, Math.max(0, (x - domain[0]) / (domain[1] - domain[0] || 1)));
    const bar = element("span", { class: "bar", "aria-hidden": "true" });
    if (known) {
      const whisker = element("span", { class: "whisker" });
      whisker.style.left = `${at(low)}%`;
      whisker.style.width = `${at(high) - at(low)}%`;
      bar.append(whisker);
    }
    const dot = element("span", { class: "dot" });
    dot.style.left = `${at(value)}%`;
    bar.append(dot);
    node.append(bar);
  }
  return node;
}

const BADGES = {
  unverified: "as submitted, not recomputed",
  recomputed: "means recomputed from the episodes",
  "spot-rerun": "some episodes played and explained again",
  "re-executed": "all episodes played and explained again",
};

const badge = (status) =>
  status ? element("span", { class: `badge ${status}`, title: BADGES[status] ?? status }, status) : element("span");

/** What the submitter says of the public seeds, and what fresh seeds say: beside the badge. */
function freshNode({ fresh, variantsTried }) {
  const node = element("span", { class: "fresh" });
  if (fresh) {
    const [publicMean, freshMean] = fresh.means;
    node.append(element("small", { class: fresh.worse ? "gate" : null,
      title: fresh.worse ?? `${plainHeading(fresh.decides)}: ${number(publicMean)} on the public seeds, ${number(freshMean)} on fresh ones, from ${fresh.value}` },
    " public \u2212 fresh ", intervalNode(...fresh.difference, null)));
  }
  if (variantsTried !== null) node.append(element("small", { title: "the submitter's word" }, ` ${variantsTried} ${variantsTried === 1 ? "variant" : "variants"} tried`));
  return node;
}

const loading = {};

/** The details of a policy's entries by id, loaded once. */
function loadDetails(policy) {
  loading[policy.key] ??= new Promise((resolve, reject) => {
    document.head.append(element("script", {
      src: policy.script,
      load: () => resolve(globalThis[`XMARL_${policy.key}`]),
      error: () => reject(new Error(`${policy.script} could not be loaded: build the board again.`)),
    }));
  });
  return loading[policy.key];
}

/** Show in `place` the elements that `make` returns, or its error. A later call for the same place wins. */
async function show(place, make) {
  const turn = (place.turn = (place.turn ?? 0) + 1);
  let made;
  try {
    made = await make();
  } catch (error) {
    console.error(error);
    made = [element("p", { class: "gate" }, error.message)];
  }
  if (place.turn === turn) place.replaceChildren(...made);
}
