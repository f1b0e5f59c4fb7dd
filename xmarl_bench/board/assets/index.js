// The leaderboard: the choices at the top filter all tables and charts, and are part of the address.
"use strict";

const $ = (id) => document.getElementById(id);
const ORDER = BOARD.order.by;
const unique = (values) => [...new Set(values)];

/** Fill a <select> with [value, text] pairs, keeping the choice if it is still there. */
function fill(select, pairs) {
  const kept = select.value;
  select.replaceChildren(...pairs.map(([value, text]) => element("option", { value }, text)));
  if (pairs.some(([value]) => value === kept)) select.value = kept;
}

const shortTask = (task) => task.replace(/^blind_/, "").replace(/_v\d+$/, "");
const inScope = ({ table }) =>
  table.protocol === $("protocol").value && table.oracle === $("oracle").value &&
  (!$("task").value || table.task === $("task").value) &&
  (!$("agents").value || String(table.n_agents) === $("agents").value);
const policyLabel = (policy) => {
  const n = BOARD.tables[policy.table].n_agents;
  return `${policy.name}, ${n} agents${policy.trained_n_agents === n ? "" : ` (trained with ${policy.trained_n_agents})`}`;
};

/** The range of a metric's bars: that of its intervals, limited to keep bars readable. */
const domains = Object.fromEntries(METRICS.map((name) => {
  const values = rows.flatMap((row) => row.metrics[name] ?? []).filter((value) => value !== null);
  const [low, high] = d3.extent(values.length ? values : [0, 1]);
  return [name, [Math.max(low, -1), Math.min(high, name === "median_kl" ? high : 2)]];
}));

function metricColumn(name, main) {
  const barred = name === ORDER || BOARD.paper.includes(name);
  return {
    title: HEADINGS[name], name, className: `number${main ? "" : " more"}`, visible: main,
    data: (row, type) => {
      const summary = row.metrics[name];
      if (type === "sort" || type === "type") return summary?.[0] ?? -Infinity;
      return summary;
    },
    render: (summary, type, row) => {
      if (type !== "display") return summary;
      if (!summary) return element("span", { class: "none", title: row.why[name] ?? "" }, "\u2013");
      return intervalNode(...summary, barred ? domains[name] : null, name !== ORDER);
    },
    type: "num", orderSequence: ["desc", "asc"],
  };
}

const text = (title, get, node = null, more = {}) => ({
  title, data: get, render: (value, type, row) => (type !== "display" ? value : node ? node(row) : document.createTextNode(value)), ...more,
});

const scores = new DataTable("#scores", {
  data: rows, autoWidth: false, pageLength: 50, lengthMenu: [25, 50, 100, 500], order: [],
  columns: [
    text("rank", (row) => row.rank ?? Infinity, (row) => row.rank === null && row.policy.gate && !row.control
      ? element("span", { class: "gate", title: `Not ranked: ${row.policy.gate}.` }, "not ranked") : placeNode(row.rank, row.rankInterval, row.tie),
    { type: "num", className: "place" }),
    text("explainer", (row) => row.explainer, (row) => element("span", {},
      row.id ? element("a", { href: `entry.html#${row.id}` }, row.explainer) : row.explainer,
      row.control ? element("small", {}, " control") : null, row.submitter ? element("small", {}, ` ${row.submitter}`) : null)),
    text("policy", (row) => row.policy.name),
    text("agents", (row) => row.table.n_agents, null, { type: "num" }),
    ...METRICS.map((name) => metricColumn(name, name === ORDER || BOARD.paper.includes(name) || name === "success_on_explanation")),
    text("verification", (row) => row.verification, (row) => element("span", {}, badge(row.verification), freshNode(row))),
  ],
  createdRow: (line, row) => line.classList.toggle("control", row.control),
  language: { search: "Search", lengthMenu: "_MENU_ rows a page", info: "_START_\u2013_END_ of _TOTAL_ rows", infoFiltered: "(of _MAX_)",
    infoEmpty: "no rows", zeroRecords: "No rows match: remove a filter above.", emptyTable: "No entries yet." },
  layout: { topStart: "search", topEnd: "info", bottomStart: "pageLength", bottomEnd: "paging" },
});
// Only the table scrolls sideways, not its search field and pages.
const scroller = element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Scores, scrolls sideways" });
$("scores").replaceWith(scroller);
scroller.append(scores.table().node());
scores.search.fixed("scope", (_, row) =>
  inScope(row) && (!$("policy").value || row.policy.key === $("policy").value) &&
  (!$("kind").value || row.control === ($("kind").value === "1")) &&
  (!$("verification").value || row.verification === $("verification").value));

const rankingColumns = [
  text("rank", (row) => row.rank ?? Infinity, (row) => placeNode(row.rank, row.rank_interval, row.tie_group), { type: "num", className: "place" }),
  text("explainer", (row) => row.explainer, (row) => element("span", {}, row.explainer, row.control ? element("small", {}, " control") : null)),
  { title: HEADINGS[ORDER], className: "number", type: "num", orderSequence: ["desc", "asc"], data: "value",
    render: (value, type, row) => (type !== "display" ? value : intervalNode(value, ...(row.interval ?? [null, null]), [-0.2, 1])) },
  { title: "IQM", className: "number", type: "num", orderSequence: ["desc", "asc"], data: "iqm",
    render: (value, type) => (type !== "display" ? value : document.createTextNode(number(value))) },
  ...BOARD.paper.map((name) => ({ title: HEADINGS[name], className: "number", type: "num", orderSequence: ["desc", "asc"],
    data: (row, type) => (type === "sort" || type === "type" ? row.means[name] ?? -Infinity : row.means[name]),
    render: (value, type) => (type !== "display" ? value : document.createTextNode(number(value))) })),
  text("policies", (row) => row.n_policies, null, { type: "num", className: "number" }),
];
const ranking = new DataTable("#ranking", {
  data: [], columns: rankingColumns, autoWidth: false, paging: false, searching: false, info: false, order: [[2, "desc"]],
  createdRow: (line, row) => line.classList.toggle("control", row.control),
  language: { emptyTable: "Nothing is ranked here: no policy of this selection passes the gate, or explainers share too few policies." },
});

/** The ranking of the current choice, if there is one. */
function chosenRanking() {
  const [protocol, oracle, task, agents] = ["protocol", "oracle", "task", "agents"].map((id) => $(id).value);
  return BOARD.rankings.find((each) => each.protocol === protocol && each.oracle === oracle &&
    (task || agents ? each.task === task && String(each.n_agents) === agents : each.task === null));
}

function showRanking() {
  const [task, agents] = ["task", "agents"].map((id) => $(id).value);
  const all = !task && !agents;
  const found = chosenRanking();
  ranking.clear().rows.add(found?.rows ?? []).draw();
  const half = !all && !(task && agents);
  $("ranking-note").textContent = half ? "Choose both a task and a team size, or neither, for a ranking over policies."
    : found ? `Over ${found.n_policies} ${found.n_policies === 1 ? "policy" : "policies"} that all ranked explainers were scored on.` : "";
  fill($("profile-explainer"), (found?.rows ?? []).filter((row) => row.rank !== null).map(({ explainer }) => [explainer, explainer]));
}

function showProfiles() {
  const place = $("profile-figure");
  return show(place, async () => {
    const found = chosenRanking();
    const explainer = $("profile-explainer").value;
    if (!explainer) return [element("p", { class: "dim" }, "Nothing is ranked here.")];
    return profileChart(place, found, explainer, plainHeading(ORDER));
  });
}

function showPolicyNote() {
  const policy = BOARD.policies.find(({ key }) => key === $("policy").value);
  if (!policy) return void $("policy-note").replaceChildren();
  const m = policy.metrics;
  const parts = [`attention-entropy weight ${policy.lambda}`, `success ${number(m.success_rate, 2)}`, `no agent collision ${number(m.no_agent_collision, 2)}`,
    m.no_object_collision === null ? null : `no wall contact ${number(m.no_object_collision, 2)}`, `makespan ${number(m.makespan, 0)}`,
    `communication dependence ${number(m.communication_dependence)}`, `attention entropy ${number(m.attention_entropy, 2)}`,
    policy.oracle_error === null ? null : `standard error of sampling at most ${number(policy.oracle_error, 3)}`];
  $("policy-note").replaceChildren(`${policy.name}: ${parts.filter(Boolean).join(", ")}.`,
    ...(policy.gate ? [element("strong", { class: "gate" }, ` Not ranked: ${policy.gate}.`)] : []));
}

function showBudget() {
  const policy = BOARD.policies.find(({ key }) => key === $("budget-policy").value);
  const place = $("budget-figure");
  return show(place, async () => {
    if (!policy) return [element("p", { class: "dim" }, "No policy matches.")];
    const details = await loadDetails(policy);
    const named = rows.filter((row) => row.policy === policy && row.id && !row.control).map((row) => [row.explainer, details[row.id]]);
    return budgetChart(place, named, $("budget-kind").value);
  });
}

const SELECTION = {
  task: ["Task", (row) => row.table.task, shortTask],
  agents: ["Team size", (row) => String(row.table.n_agents), (value) => value],
  lambda: ["Attention entropy", (row) => (row.policy.lambda > 0 ? "with" : "without"), (value) => `${value} regularisation`],
  policy: ["Policy", (row) => row.policy.name, (value) => value],
  explainer: ["Explainer", (row) => row.explainer, (value) => value],
};
const scored = () => rows.filter((row) => row.id && row.table.protocol === $("protocol").value && row.table.oracle === $("oracle").value);
const chosen = (side) => scored().filter((row) =>
  Object.entries(SELECTION).every(([name, [, get]]) => [get(row), ""].includes($(`${side}-${name}`).value)));

function makeSelections() {
  for (const side of ["a", "b"]) {
    const form = $(`selection-${side}`);
    form.replaceChildren(element("strong", {}, side.toUpperCase()), ...Object.entries(SELECTION).map(([name, [label]]) =>
      element("label", {}, label, " ", element("select", { id: `${side}-${name}`, change: showViolins }))));
  }
  fillSelections();
  for (const [side, value] of [["a", "without"], ["b", "with"]]) {
    const select = $(`${side}-lambda`);
    if ([...select.options].some((option) => option.value === value)) select.value = value;
  }
}

function fillSelections() {
  for (const side of ["a", "b"]) {
    for (const [name, [, get, say]] of Object.entries(SELECTION)) {
      const values = unique(scored().map(get)).sort(d3.ascending);
      fill($(`${side}-${name}`), [["", "all"], ...values.map((value) => [value, say(value)])]);
    }
  }
}

function showViolins() {
  const place = $("violin-figure");
  return show(place, async () => {
    const metric = $("violin-metric").value;
    const samples = [];
    for (const side of ["a", "b"]) {
      const groups = new Map();
      for (const row of chosen(side).filter((row) => !row.control)) {
        const values = (await loadDetails(row.policy))[row.id].episodes[metric] ?? [];
        groups.set(row.explainer, [...(groups.get(row.explainer) ?? []), ...values.filter((value) => value !== null)]);
      }
      for (const [group, values] of groups) samples.push({ group, side: side.toUpperCase(), values });
    }
    samples.sort((one, other) => d3.ascending(one.group, other.group));
    return violinChart(place, samples, plainHeading(metric));
  });
}

/** Charts are drawn when they come into view, because they load data that no table needs. */
const lazily = (id, draw) => new IntersectionObserver((entries, observer) => {
  if (entries.some((entry) => entry.isIntersecting)) { observer.disconnect(); draw(); }
}, { rootMargin: "200px" }).observe($(id));

function showDefinitions() {
  $("definitions").replaceChildren(...Object.entries(BOARD.protocols[$("protocol").value].definitions)
    .flatMap(([name, meaning]) => [element("dt", {}, name), element("dd", {}, meaning)]));
}

const IN_ADDRESS = ["protocol", "oracle", "task", "agents", "policy", "kind", "verification", "columns"];

function writeAddress() {
  const wanted = new URLSearchParams();
  for (const id of IN_ADDRESS) if ($(id).value && $(id).value !== $(id).options[0]?.value) wanted.set(id, $(id).value);
  history.replaceState(null, "", `#${wanted}`);
}

const gated = (key) => Number(BOARD.policies.find((policy) => policy.key === key).gate !== null);

function scopeChanged() {
  const policies = BOARD.policies.filter((policy) => inScope({ table: BOARD.tables[policy.table] }));
  const pairs = policies.map((policy) => [policy.key, policyLabel(policy)]);
  fill($("policy"), [["", "all"], ...pairs]);
  fill($("budget-policy"), [...pairs].sort(([one], [other]) => gated(one) - gated(other)));
  showRanking();
  showDefinitions();
  rowsChanged();
}

function rowsChanged() {
  writeAddress();
  showPolicyNote();
  scores.draw();
}

function columnsChanged() {
  writeAddress();
  scores.columns(".more").visible($("columns").value === "all");
}

function start() {
  fill($("protocol"), unique(BOARD.tables.map(({ protocol }) => protocol)).map((key) => [key, describeProtocol(key)]));
  fill($("oracle"), unique(BOARD.tables.map(({ oracle }) => oracle)).map((kind) => [kind, kind]));
  fill($("task"), [["", "all"], ...unique(BOARD.tables.map(({ task }) => task)).map((task) => [task, shortTask(task)])]);
  fill($("agents"), [["", "all"], ...unique(BOARD.tables.map((table) => table.n_agents)).sort(d3.ascending).map((n) => [String(n), String(n)])]);
  fill($("verification"), [["", "all"], ...unique(rows.map(({ verification }) => verification)).filter(Boolean).sort().map((status) => [status, status])]);
  fill($("violin-metric"), BOARD.episode_metrics.map((name) => [name, plainHeading(name)]));
  $("violin-metric").value = ORDER;
  makeSelections();
  const asked = new URLSearchParams(location.hash.slice(1));
  for (const id of ["protocol", "oracle", "task", "agents", "kind", "verification", "columns"]) if (asked.has(id)) $(id).value = asked.get(id);
  scopeChanged();
  if (asked.has("policy")) { $("policy").value = asked.get("policy"); rowsChanged(); }
  columnsChanged();
  for (const id of ["protocol", "oracle", "task", "agents"]) $(id).addEventListener("change", () => { scopeChanged(); fillSelections(); showProfiles(); showBudget(); showViolins(); });
  for (const id of ["policy", "kind", "verification"]) $(id).addEventListener("change", rowsChanged);
  $("columns").addEventListener("change", columnsChanged);
  for (const id of ["budget-policy", "budget-kind"]) $(id).addEventListener("change", showBudget);
  $("profile-explainer").addEventListener("change", showProfiles);
  $("violin-metric").addEventListener("change", showViolins);
  for (const form of document.forms) form.addEventListener("submit", (event) => event.preventDefault());
  lazily("profile-figure", showProfiles);
  lazily("budget-figure", showBudget);
  lazily("violin-figure", showViolins);
}

start();
