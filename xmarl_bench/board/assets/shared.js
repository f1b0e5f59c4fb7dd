// Shared by the pages of scores and of an entry: the board's data, numbers, and the scripts of policies.
"use strict";

const $ = (id) => document.getElementById(id);
const METRICS = BOARD.columns.map(([name]) => name);
const HEADINGS = Object.fromEntries(BOARD.columns);
const DIGITS = Object.fromEntries(BOARD.columns.map(([name, , digits]) => [name, digits]));

const number = (value, digits = 3) =>
  value === null || value === undefined ? "\u2013" : (Object.is(value, -0) ? 0 : value).toFixed(digits).replace("-", "\u2212");

/** The rows of the board as objects, each with its policy and table. */
const rows = BOARD.rows.map((row) => {
  const policy = BOARD.policies[row[0]];
  return {
    policy, table: BOARD.tables[policy.table], explainer: row[1], control: row[2] === 1, rank: row[3],
    rankInterval: row[4], tie: row[5], submitter: row[6], verification: row[7], id: row[8],
    animated: row[9] === 1, why: BOARD.reasons[row[10]], file: row[11],
    metrics: Object.fromEntries(METRICS.map((name, k) => [name, row[12][k]])), variantsTried: row[13], fresh: row[14], cost: row[15],
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
  const text = interval === null ? "" : ` ${interval[0]}\u2013${interval[1]}`;
  return element("span", {}, String(rank), element("small", {}, text), element("sup", { title: "tie group" }, letter(tie)));
}

/** A value with its interval. */
function intervalNode(value, low, high, digits = 3) {
  if (value === null) return element("span", { class: "none" }, "NaN");
  const known = low !== null && low !== undefined;
  return element("span", {}, number(value, digits), known ? element("small", {}, ` [${number(low, digits)}, ${number(high, digits)}]`) : null);
}

const badge = (status) => (status ? element("span", { class: `badge ${status}` }, status) : element("span"));

/** What the submitter says of the public seeds, and what fresh seeds say: beside the badge. */
function freshNode({ fresh, variantsTried }) {
  const node = element("span", { class: "fresh" });
  if (fresh) {
    const [publicMean, freshMean] = fresh.means;
    node.append(element("small", { class: fresh.worse ? "gate" : null,
      title: fresh.worse ?? `${plainHeading(fresh.decides)}: ${number(publicMean)} on the public seeds, ${number(freshMean)} on fresh ones, from ${fresh.value}` },
    " public \u2212 fresh ", intervalNode(...fresh.difference)));
  }
  if (variantsTried !== null) node.append(element("small", { title: "the submitter's word" }, ` ${variantsTried} ${variantsTried === 1 ? "variant" : "variants"} tried`));
  return node;
}

/** The details of a policy's entries, and its charts, in a script. */
const loadDetails = (policy) => new Promise((resolve, reject) => {
  document.head.append(element("script", {
    src: policy.script,
    load: () => resolve(globalThis[`XMARL_${policy.key}`]),
    error: () => reject(new Error(`${policy.script} could not be loaded: build the board again.`)),
  }));
});
