// One entry, given in the address: entry.html#<first 16 digits of its id>.
"use strict";

/** Nested JSON as pairs for a definition list, with names such as "a.b". */
function pairs(value, name = "") {
  if (value === null || value === undefined) return [[name, "\u2013"]];
  if (typeof value !== "object") return [[name, String(value)]];
  if (Array.isArray(value) && value.every((each) => typeof each !== "object")) return [[name, value.join(", ") || "none"]];
  const inner = Object.entries(value);
  return inner.length ? inner.flatMap(([key, each]) => pairs(each, name ? `${name}.${key}` : key)) : [[name, "none"]];
}

function showMetrics(row, details) {
  const controls = rows.filter((other) => other.policy === row.policy && other.control && other !== row);
  const random = controls.find(({ explainer }) => explainer === "random");
  const oracle = controls.find(({ explainer }) => explainer === "oracle");
  const lines = METRICS.map((name, k) => {
    const summary = row.metrics[name];
    const [n, nan] = details.n[name] ?? [null, 0];
    const beside = (other) => element("td", { class: "number" }, number(other?.metrics[name]?.[0], DIGITS[name]));
    return element("tr", {}, element("th", { scope: "row" }, HEADINGS[name]),
      element("td", { class: "number" }, summary ? intervalNode(...summary, DIGITS[name]) : element("span", { class: "none" }, row.why[name] ?? "not measured")),
      element("td", {}, n === null ? "" : `${n}${nan ? `, ${nan} not a number` : ""}`),
      beside(random), beside(oracle), element("td", { class: "number" }, number(details.inverted?.[k]?.[0], DIGITS[name])));
  });
  $("metrics").replaceChildren(
    element("caption", {}, "Means over episodes with 95 % intervals, and controls on the same states"),
    element("thead", {}, element("tr", {}, ...["metric", "value", "episodes", "random mask", "oracle mask", "inverted mask"].map((title) => element("th", { scope: "col" }, title)))),
    element("tbody", {}, ...lines));
}

/** Provenance in groups, each a list of names and values. */
function showProvenance(row, details) {
  const { packages, machine, os, cpu, cpu_capability: capability, threads, jobs, python, ...run } = details.provenance;
  const { policy: of, explainer } = details;
  const groups = {
    Entry: [
      ["entry", element("a", { href: row.file }, details.entry_id)],
      ["submitter", row.submitter ?? "the project"],
      ["variants tried on these seeds, as the submitter says", String(row.variantsTried ?? "\u2013")],
      ["protocol", describeProtocol(row.table.protocol)],
      ["first episode's seed", String(details.first_seed)],
      ["time for masks", `${(1000 * details.cost.explain_seconds_per_timestep).toPrecision(3)} ms per timestep`],
      ...(details.reported ? pairs(details.reported, "reported") : []),
    ],
    Verification: pairs(details.verification),
    Explainer: pairs(explainer),
    Policy: pairs(of),
    Run: pairs(run),
    Machine: pairs({ machine, os, cpu, "vector instructions": capability, threads, jobs }),
    Software: pairs({ python, ...packages }),
  };
  $("provenance").replaceChildren(...Object.entries(groups).flatMap(([title, listed]) => [element("h3", {}, title),
    element("dl", {}, ...listed.flatMap(([name, value]) => [element("dt", {}, name.replaceAll("_", " ")), element("dd", {}, value)]))]));
}

function showCommand(details) {
  const { commit, dirty, harness_version: version, cpu_capability: cpu, machine } = details.provenance;
  $("command").textContent = details.command;
  $("again-note").textContent = `With xmarl-bench ${version}${commit ? ` at commit ${commit.slice(0, 12)}${dirty ? " and uncommitted changes" : ""}` : ""}; bit for bit with the versions below on ${machine} ${cpu}. `
    + "Give the folder or file of a policy or explainer that is not registered.";
  $("copy").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(details.command);
      $("copied").textContent = "Copied.";
    } catch {
      getSelection().selectAllChildren($("command"));
      $("copied").textContent = "Selected: press Ctrl+C.";
    }
  });
}

async function showEntry() {
  const asked = location.hash.slice(1);
  const row = rows.find(({ id }) => id !== null && id === asked);
  if (!row) {
    $("summary").textContent = asked ? `This board has no entry ${asked}.` : "The address names no entry.";
    return;
  }
  const details = await loadDetails(row.policy);
  const { policy, table } = row;
  document.title = `${row.explainer} on ${policy.name}, xmarl-bench`;
  $("title").textContent = `${row.explainer} on ${policy.name}`;
  const place = row.rank === null ? [] : [" Rank ", placeNode(row.rank, row.rankInterval, row.tie), " on this policy."];
  $("summary").replaceChildren(element("a", { href: `pages/explainer-${row.explainer}.html` }, row.explainer), `, ${table.task}, ${table.n_agents} agents; ${describeProtocol(table.protocol)} of at most ${table.max_cycles} steps.`, ...place, " ", badge(row.verification), freshNode(row));
  $("gate").textContent = [policy.gate ? `Not ranked: ${policy.gate}.` : null, row.fresh?.worse].filter(Boolean).join(" ");
  const mine = details.entries[row.id];
  showMetrics(row, mine);
  showCommand(mine);
  showProvenance(row, mine);
  showEpisodes(row);
  $("budgets").innerHTML = details.charts.join("") || "<p class='dim'>This entry has no budgets: it is too old, or the team is too small.</p>";
  for (const line of $("budgets").querySelectorAll("g.line:not(.bound)")) { // this entry's line alone in colour
    const own = line.dataset.entry === row.id;
    line.classList.toggle("on", own);
    for (const chip of line.closest("figure").querySelectorAll(".chip[data-line]")) {
      if (chip.dataset.line === line.dataset.line) chip.setAttribute("aria-pressed", String(own));
    }
    if (own) line.parentNode.append(line);
  }
}

addEventListener("hashchange", () => { if (/^#[0-9a-f]{16}$/.test(location.hash)) location.reload(); });
showEntry().catch((error) => { $("summary").textContent = error.message; console.error(error); });
