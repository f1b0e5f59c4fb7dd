// Charts by Observable Plot, each with its numbers as a table for screen readers.
"use strict";

const chartStyle = { background: "none", color: "var(--ink)", fontSize: "13px", overflow: "visible" };
const chartWidth = (place) => Math.max(280, Math.min(900, place.clientWidth || 640));
const SERIES = ["#0b62a8", "#c8552b", "#2f855a", "#8a4fbe", "#b08900", "#c2417c", "#2b8fa3", "#6b7280", "#7a5230", "#4a5bd0"];

/** The table of a chart's numbers, collapsed. */
function numbersTable(caption, headings, lines) {
  return element("details", {}, element("summary", {}, "The numbers"),
    element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
      element("table", { class: "board" }, element("caption", {}, caption),
        element("thead", {}, element("tr", {}, ...headings.map((text) => element("th", { scope: "col" }, text)))),
        element("tbody", {}, ...lines.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, first),
          ...rest.map((text) => element("td", {}, text))))))));
}

/** FidDelta@k of some entries of one policy. named: [[explainer, details]]. */
function budgetChart(place, named, kind) {
  const points = [];
  const bounds = named.map(([, details]) => details.budgets[kind]).find((curves) => curves.oracle);
  for (const [name, details] of named) {
    (details.budgets[kind].explained ?? []).forEach(([value, low, high], k) => points.push({ name, k: k + 1, value, low, high }));
  }
  for (const name of ["oracle", "random"]) {
    (bounds?.[name] ?? []).forEach(([value], k) => points.push({ name, k: k + 1, value }));
  }
  if (!points.length) return [element("p", { class: "dim" }, "These entries have no such budgets: they are too old, or the team is too small.")];
  const explained = named.map(([name]) => name);
  const names = [...(bounds ? ["oracle", "random"] : []), ...explained];
  const bound = (point) => point.name === "oracle" || point.name === "random";
  const chart = Plot.plot({
    width: chartWidth(place), height: 320, marginLeft: 55, style: chartStyle,
    ariaLabel: "FidDelta against the budget k", ariaDescription: "One line per explainer between a random ranking and the oracle",
    color: { domain: names, range: names.map((name) => name === "oracle" || name === "random" ? "var(--dim)" : SERIES[explained.indexOf(name) % SERIES.length]), legend: true },
    x: { label: "edges kept in each row, k", ticks: d3.range(1, 1 + d3.max(points, (point) => point.k)), tickFormat: "d", inset: 20 },
    y: { label: "FidDelta@k, action units", grid: true, nice: true },
    marks: [
      Plot.areaY(points.filter((point) => point.high !== undefined), { x: "k", y1: "low", y2: "high", z: "name", fill: "name", fillOpacity: 0.15 }),
      Plot.lineY(points.filter((point) => !bound(point)), { x: "k", y: "value", z: "name", stroke: "name", strokeWidth: 2 }),
      Plot.lineY(points.filter(bound), { x: "k", y: "value", stroke: "name", z: "name", strokeDasharray: "5 4" }),
      Plot.dot(points, { x: "k", y: "value", fill: "name", r: 3.5, tip: true, title: (point) => `${point.name}, k = ${point.k}: ${number(point.value)}` }),
      Plot.text(points.filter((point) => bound(point) && point.k === d3.max(points, (other) => other.k)), { x: "k", y: "value", text: "name", dx: 8, textAnchor: "start", fill: "var(--dim)" }),
    ],
    marginRight: 60,
  });
  const lines = points.map((point) => [point.name, String(point.k), number(point.value), point.low === undefined ? "\u2013" : `[${number(point.low)}, ${number(point.high)}]`]);
  return [chart, numbersTable("FidDelta at every budget", ["curve", "k", "mean", "95 %"], lines)];
}

/** Performance profiles of a ranking's explainers; band and probabilities of improvement are those of `chosen`. */
function profileChart(place, ranking, chosen, heading) {
  const ranked = ranking.rows.filter((row) => row.rank !== null);
  const taus = ranked.flatMap((row) => row.profile.map(([tau]) => tau)).filter((tau) => tau !== null);
  const [low, high] = d3.extent(taus);
  const beyond = 0.05 * (high - low || 1);
  const points = ranked.flatMap(({ explainer, profile }) => [...profile, [high + beyond, ...profile.at(-1).slice(1)]]
    .map(([tau, share, least, most]) => ({ explainer, tau: tau ?? low - beyond, share, least, most })));
  const names = ranked.map((row) => row.explainer);
  const colour = (name) => SERIES[names.indexOf(name) % SERIES.length];
  const step = { x: "tau", y: "share", z: "explainer", stroke: "explainer", curve: "step-after" };
  const chart = Plot.plot({
    width: chartWidth(place), height: 350, marginLeft: 55, marginBottom: 45, style: chartStyle,
    ariaLabel: "Share of policies above a score", ariaDescription: "One falling step curve per explainer, the chosen one with its band",
    color: { domain: names, range: names.map(colour), legend: true },
    x: { label: heading, labelOffset: 40, inset: 5 }, y: { label: "share of policies above", domain: [0, 1], grid: true },
    marks: [
      Plot.areaY(points.filter(({ explainer }) => explainer === chosen), { x: "tau", y1: "least", y2: "most", curve: "step-after", fill: colour(chosen), fillOpacity: 0.18 }),
      Plot.lineY(points.filter(({ explainer }) => explainer !== chosen), { ...step, strokeWidth: 1.5, strokeOpacity: 0.7 }),
      Plot.lineY(points.filter(({ explainer }) => explainer === chosen), { ...step, strokeWidth: 4 }),
      Plot.dot(points, { x: "tau", y: "share", fill: "explainer", r: 2.5, tip: true, title: ({ explainer, tau, share }) => `${explainer}: ${number(share, 2)} above ${number(tau)}` }),
    ],
  });
  const better = ranking.improvement[chosen];
  const lines = ranked.filter(({ explainer }) => explainer !== chosen).map(({ explainer }) => [explainer, number(better[explainer], 2)]);
  return [chart, numbersTable(`Probability that ${chosen} does better`, ["than", "probability"], lines)];
}

/** Gaussian kernel density of values on a grid, by Silverman's rule; null if all values are equal. */
function density(values, steps = 60) {
  const spread = Math.min(d3.deviation(values) ?? 0, (d3.quantile(values, 0.75) - d3.quantile(values, 0.25)) / 1.34 || Infinity);
  if (!(spread > 0)) return null;
  const bandwidth = 0.9 * spread * values.length ** -0.2;
  const [low, high] = d3.extent(values);
  return d3.range(steps + 1).map((k) => {
    const y = low - bandwidth + (k / steps) * (high - low + 2 * bandwidth);
    return { y, density: d3.mean(values, (value) => Math.exp(-0.5 * ((y - value) / bandwidth) ** 2)) };
  });
}

/** Violins side by side. samples: [{group, side: "A" | "B", values}]. */
function violinChart(place, samples, heading) {
  const full = samples.filter(({ values }) => values.length);
  if (!full.length) return [element("p", { class: "dim" }, "Neither selection has values of this metric.")];
  const groups = [...new Set(full.map(({ group }) => group))];
  const areas = [], middles = [], quartiles = [];
  for (const { group, side, values } of full) {
    const centre = side === "A" ? -0.55 : 0.55;
    const curve = density(values);
    const widest = curve ? d3.max(curve, (point) => point.density) : 1;
    const mine = { group, side };
    for (const point of curve ?? []) {
      areas.push({ ...mine, y: point.y, x1: centre - (0.5 * point.density) / widest, x2: centre + (0.5 * point.density) / widest });
    }
    middles.push({ ...mine, x1: centre - 0.2, x2: centre + 0.2, x: centre, y: d3.median(values) });
    quartiles.push({ ...mine, x: centre, y1: d3.quantile(values, 0.25), y2: d3.quantile(values, 0.75) });
  }
  const narrow = chartWidth(place) < 110 * groups.length;
  const width = Math.max(chartWidth(place), 110 * groups.length);
  const chart = Plot.plot({
    width, height: 360, marginLeft: 55, style: narrow ? { ...chartStyle, maxWidth: "none" } : chartStyle,
    ariaLabel: `${heading} by episode, selections A and B`, ariaDescription: "Violins: density of the episodes, with median and quartiles",
    color: { domain: ["A", "B"], range: ["#3b82c4", "#e07b39"], legend: true },
    fx: { domain: groups, label: null }, x: { axis: null, domain: [-1.15, 1.15] }, y: { label: heading, grid: true, nice: true },
    marks: [
      Plot.areaX(areas, { fx: "group", y: "y", x1: "x1", x2: "x2", z: "side", fill: "side", fillOpacity: 0.75, curve: "basis" }),
      Plot.ruleX(quartiles, { fx: "group", x: "x", y1: "y1", y2: "y2", stroke: "var(--ink)", strokeWidth: 3 }),
      Plot.ruleY(middles, { fx: "group", y: "y", x1: "x1", x2: "x2", stroke: "var(--ink)", strokeWidth: 2 }),
      Plot.dot(middles, { fx: "group", x: "x", y: "y", fill: "side", stroke: "var(--ink)", r: 4, tip: true, title: ({ group, side, y }) => `${group}, ${side}: median ${number(y)}` }),
    ],
  });
  const lines = full.map(({ group, side, values }) => [group, side, String(values.length), number(d3.mean(values)),
    ...[0.25, 0.5, 0.75].map((q) => number(d3.quantile(values, q)))]);
  return [element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Violins, scroll sideways" }, chart),
    numbersTable(`${heading} over episodes`, ["explainer", "selection", "episodes", "mean", "quartile", "median", "quartile"], lines)];
}
