// Scores by policy: filters and columns, all in the address.
"use strict";

const unique = (values) => [...new Set(values)];
const shortTask = (task) => task.replace(/^blind_/, "").replace(/_v\d+$/, "");
const CHOICES = ["protocol", "oracle", "task", "agents", "policy", "verification", "columns"];
const OF_POLICY = [["success_rate", "success"], ["no_agent_collision", "no agent collision"], ["no_object_collision", "no wall contact"],
  ["makespan", "makespan"], ["communication_dependence", "communication dependence"], ["attention_entropy", "attention entropy"]];

/** Fill a <select> with [value, text] pairs, keeping the choice if it is still there. */
function fill(select, pairs) {
  const kept = select.value;
  select.replaceChildren(...pairs.map(([value, text]) => element("option", { value }, text)));
  if (pairs.some(([value]) => value === kept)) select.value = kept;
}

const inScope = ({ table }) =>
  table.protocol === $("protocol").value && table.oracle === $("oracle").value &&
  (!$("task").value || table.task === $("task").value) &&
  (!$("agents").value || String(table.n_agents) === $("agents").value);

const asked = (row) => inScope(row) &&
  (!$("policy").value || row.policy.key === $("policy").value) &&
  (!$("verification").value || row.verification === $("verification").value) &&
  `${row.explainer} ${row.policy.name} ${row.submitter ?? ""}`.toLowerCase().includes($("search").value.toLowerCase());

const isMain = (name) => name === BOARD.order || BOARD.paper.includes(name) || name === "success_on_explanation";

/** [title, metric or name of a definition, better, cell of a row] of every column. */
function columns() {
  const cell = (content, value = null, className = null) => element("td", { class: className, "data-value": value }, content);
  const metrics = METRICS.filter((name) => isMain(name) || $("columns").value === "all");
  return [
    ["rank", "rank", "lower", (row) => cell(row.rank === null && row.policy.gate && !row.control
      ? element("span", { class: "gate", title: `Not ranked: ${row.policy.gate}.` }, "not ranked") : placeNode(row.rank, row.rankInterval, row.tie), row.rank ?? "")],
    ["explainer", "explainer", "lower", (row) => element("th", { scope: "row" }, row.id ? element("a", { href: `entry.html#${row.id}` }, row.explainer) : row.explainer)],
    ["policy", "policy", "lower", (row) => cell(row.policy.name)],
    ["agents", "agents", "lower", (row) => cell(String(row.table.n_agents), row.table.n_agents, "number")],
    ...metrics.map((name) => [HEADINGS[name], name, HEADINGS[name].endsWith("\u2191") ? "higher" : HEADINGS[name].endsWith("\u2193") ? "lower" : "none", (row) => {
      const summary = row.metrics[name];
      if (!summary) return cell(element("span", { class: "none", title: row.why[name] ?? "" }, "\u2013"), "", "number");
      const content = name === BOARD.order ? intervalNode(...summary, DIGITS[name]) : number(summary[0], DIGITS[name]);
      return cell(content, summary[0] ?? "", "number");
    }]),
    ["ms \u2193", "cost", "lower", (row) => cell(row.cost === null ? "\u2013" : String(row.cost), row.cost ?? "", "number")],
    ["submitter", "submitter", "lower", (row) => cell(row.submitter ?? (row.control ? "" : "the project"))],
    ["badge", "badge", "lower", (row) => cell(element("span", {}, badge(row.verification), freshNode(row)))],
  ];
}

let clear = () => {};

function draw() {
  const shown = rows.filter(asked);
  const made = columns();
  const groups = [
    ["", shown.filter((row) => !row.control && row.rank !== null)],
    ["not ranked", shown.filter((row) => !row.control && row.rank === null)],
    ["controls", shown.filter((row) => row.control)],
  ];
  clear();
  $("scores").replaceChildren(
    element("thead", {}, element("tr", {}, ...made.map(([title, about, better]) => element("th", { scope: "col", "data-sort": better },
      element("button", { type: "button", "data-def": about, "aria-describedby": `def-${about}` }, title.replace(/ ([\u2191\u2193])$/, "\u00a0$1")))))),
    ...groups.filter(([, each], k) => k === 0 || each.length).map(([name, each]) => element("tbody", name ? { "data-group": name } : {},
      ...each.map((row) => element("tr", { class: row.control ? "control" : null }, ...made.map(([, , , cell]) => cell(row)))))));
  clear = enhance($("scores"));
  showPolicyNote(shown.length);
}

function showPolicyNote(count) {
  const policy = BOARD.policies.find(({ key }) => key === $("policy").value);
  const rowsSaid = count === 0 ? "No rows match: remove a filter." : `${count} ${count === 1 ? "row" : "rows"}.`;
  if (!policy) return void $("policy-note").replaceChildren(rowsSaid);
  const parts = [`attention-entropy weight ${policy.lambda}`,
    ...OF_POLICY.filter(([name]) => policy.metrics[name] !== null).map(([name, title]) => `${title} ${number(policy.metrics[name], name === "makespan" ? 0 : 2)}`),
    policy.oracle_error === null ? null : `standard error of sampling at most ${number(policy.oracle_error)}`];
  $("policy-note").replaceChildren(`${rowsSaid} ${policy.name}: ${parts.filter(Boolean).join(", ")}.`,
    ...(policy.gate ? [element("strong", { class: "gate" }, ` Not ranked: ${policy.gate}.`)] : []));
}

function fillPolicies() {
  const policies = BOARD.policies.filter((policy) => inScope({ table: BOARD.tables[policy.table] }));
  const label = (policy) => {
    const n = BOARD.tables[policy.table].n_agents;
    return `${policy.name}, ${n} agents${policy.trained_n_agents === n ? "" : ` (trained with ${policy.trained_n_agents})`}`;
  };
  fill($("policy"), [["", "all"], ...policies.map((policy) => [policy.key, label(policy)])]);
}

function changed() {
  fillPolicies();
  const values = [...CHOICES, "search"].map((id) => [id, $(id).value === $(id).options?.[0]?.value ? "" : $(id).value]);
  address.write(Object.fromEntries(values));
  draw();
}

function start() {
  fill($("protocol"), unique(BOARD.tables.map(({ protocol }) => protocol)).map((key) => [key, describeProtocol(key)]));
  fill($("oracle"), unique(BOARD.tables.map(({ oracle }) => oracle)).map((kind) => [kind, kind]));
  fill($("task"), [["", "all"], ...unique(BOARD.tables.map(({ task }) => task)).map((task) => [task, shortTask(task)])]);
  fill($("agents"), [["", "all"], ...unique(BOARD.tables.map((table) => table.n_agents)).sort((a, b) => a - b).map((n) => [String(n), String(n)])]);
  fill($("verification"), [["", "all"], ...unique(rows.map(({ verification }) => verification)).filter(Boolean).sort().map((status) => [status, status])]);
  const wanted = address.read();
  for (const id of CHOICES) {
    if (id === "policy") fillPolicies();
    if (wanted.has(id)) $(id).value = wanted.get(id);
  }
  $("search").value = wanted.get("search") ?? "";
  draw();
  for (const id of CHOICES) $(id).addEventListener("change", changed);
  $("search").addEventListener("input", changed);
  $("scope").addEventListener("submit", (event) => event.preventDefault());
}

start();
