"""The files of a study: results, tables for a paper, figures for print and dark screens, a page."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.made_entries import ARCHITECTURE, made_entry
from xmarl_bench.entry.schema import Entry
from xmarl_bench.metrics.student import Design, interval_of
from xmarl_bench.papers.kailas2025 import figures
from xmarl_bench.papers.kailas2025.claims import GNN
from xmarl_bench.papers.kailas2025.figures import INK, draw
from xmarl_bench.papers.kailas2025.output import write_study
from xmarl_bench.papers.kailas2025.plan import STUDIES
from xmarl_bench.papers.kailas2025.results import StudyData, core_hours, quality, results_of
from xmarl_bench.papers.kailas2025.samples import Samples
from xmarl_bench.papers.kailas2025.tables import Table, decisive, tables_of
from xmarl_bench.policy import PolicyCard

pytestmark = pytest.mark.slow

LEVELS = {"attention": 0.6, "gnn_explainer": 0.4, "graphmask-pyg": 0.2}
TASK = "blind_navigation_v0"


def pair(explainer: str, n_agents: int, attention_entropy: float, seed: int = 0) -> tuple[PolicyCard, Entry]:
    name = f"navigation-n{n_agents}-lambda{attention_entropy:g}-seed{seed}"
    level = LEVELS[explainer] + 0.2 * (attention_entropy > 0)
    entry = made_entry(
        name, explainer, level, n_agents=n_agents, attention_entropy=attention_entropy, episodes=12
    )
    card = PolicyCard(
        name=name, task=TASK, n_agents=n_agents, attention_entropy=attention_entropy, training_seed=seed,
        architecture=ARCHITECTURE, weights_sha256=entry.policy.weights_sha256,
    )  # fmt: skip
    return card, entry


@pytest.fixture(scope="module")
def data() -> StudyData:
    """Navigation with 3 and 4 agents; no passage, no discovery."""
    pairs = [
        pair(name, n, weight, seed)
        for n in (3, 4)
        for weight in (0.0, 0.2)
        for seed in range(3)
        for name in LEVELS
    ]
    return StudyData(STUDIES["main"], tuple(LEVELS), pairs, Samples.of(pairs))


@pytest.fixture(scope="module")
def written(data: StudyData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With figures of only two metrics, because each takes half a second."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "METRICS", ("fid_delta", "gef"))
        write_study(folder, data)
    return folder


def test_what_the_entries_of_a_policy_share_costs_once() -> None:
    first, second, other = (pair(*of)[1] for of in (("attention", 3, 0.0), (GNN, 3, 0.0), (GNN, 4, 0.0)))
    # Each explains 100 timesteps at 0.001 s and plays for 1 s; oracle and controls take 0.001 s a timestep.
    assert core_hours([first, second, other]) == pytest.approx((3 * 1.1 + 2 * 0.1) / 3600)


def test_results_list_missing_cells_and_verdicts(data: StudyData) -> None:
    results = results_of(data)
    assert len(results["missing"]) == 14
    assert "passage, N = 3, with the term" in results["missing"]
    ledger = {claim["id"]: claim for claim in results["ledger"]}
    improved = ledger["main-attention-fid-delta"]
    assert improved["verdict"] == "held"
    assert improved["counts"] == {"held": 2, "not held": 0, "not decided": 0, "not measured": 7}
    assert improved["overall"][0]["difference"] == pytest.approx(0.2, abs=0.05)
    assert ledger["main-attention-gef"]["verdict"] == "not held"  # it rises, and lower is better
    assert ledger["main-object-collisions"]["verdict"] == "not measured"
    assert ledger["main-attention-over-gnn-with"]["verdict"] == "held"
    assert ledger["main-gnn-best"]["verdict"] == "not held"
    budgeted = next(lens for lens in results["lenses"] if lens["name"] == "budgeted fidelity")
    assert {claim["id"]: claim["verdict"] for claim in budgeted["claims"]}[
        "main-attention-fid-delta"
    ] == "held"
    performance = [each for each in results["performance"] if each["measure"] == "success_rate"]
    assert performance[0]["paper"] == {"mean": 0.99, "std": 0.10}
    assert (performance[0]["mean"], performance[0]["n_episodes"]) == (pytest.approx(0.9), 36)
    assert all(policy["gate"] is None for policy in results["policies"])


def test_the_gate_is_the_leaderboard_s() -> None:
    card, _ = pair("attention", 3, 0.0)
    entry = made_entry(card.name, "attention", 0.5, episodes=2, success_gain=0.0, reward_gain=0.0)
    results = results_of(
        StudyData(STUDIES["main"], ("attention",), [(card, entry)], Samples.of([(card, entry)]))
    )
    assert results["policies"][0]["gate"].startswith("messages are not shown to help")


def test_the_same_entries_give_the_same_bytes(data: StudyData, written: Path, tmp_path: Path) -> None:
    write_study(tmp_path, data, figures=False)
    files = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    for file in files:
        if file.name != "report.html":  # the other one holds the figures
            assert (tmp_path / file).read_bytes() == (written / file).read_bytes(), file
    figure = draw(data, "gef", "paper", list(LEVELS))
    assert figure.svg == (written / "figures" / "gef-paper.svg").read_text()
    assert figure.pdf == (written / "figures" / "gef-paper.pdf").read_bytes()


def test_tables_are_rectangular_in_markdown_and_latex(data: StudyData) -> None:
    tables = tables_of(results_of(data))
    assert {"fid_delta", "gef", "performance", "ledger", "beyond", "lenses"} <= {each.name for each in tables}
    for table in tables:
        lines = table.markdown().splitlines()
        assert len(lines) == 2 + len(table.rows)
        assert {line.count(" | ") for line in lines} == {len(table.header) - 1}
        body = re.findall(r"^(.*) \\\\$", table.latex(), re.MULTILINE)
        assert len(body) == 1 + len(table.rows)
        assert {len(re.findall(r"(?<!\\)&", row)) for row in body} == {len(table.header) - 1}


def test_latex_is_escaped() -> None:
    table = Table("x", "a_b", ("p", "q"), (("100 %", "< 0.1 ± 2"),), 1)
    assert table.latex() == (
        "\\begin{table}\n\\centering\n\\caption{a\\_b}\n\\begin{tabular}{lr}\n"
        "\\toprule\np & q \\\\\n\\midrule\n"
        "100 \\% & $<$ 0.1 $\\pm$ 2 \\\\\n\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    )


def test_the_numbers_shown_are_of_the_deciding_comparison() -> None:
    def overall(*verdicts: str) -> list[dict[str, str]]:
        return [{"verdict": verdict, "metric": str(k)} for k, verdict in enumerate(verdicts)]

    for verdict, verdicts, shown in (
        ("not held", ("held", "not decided", "not held"), "2"),
        ("held", ("not decided", "held"), "1"),
        ("not held", ("held", "not decided"), "1"),
        ("not decided", ("held", "held"), "0"),
    ):
        assert decisive({"verdict": verdict, "overall": overall(*verdicts)})["metric"] == shown


def test_a_quality_table_has_the_means(data: StudyData) -> None:
    table = next(each for each in tables_of(results_of(data)) if each.name == "fid_delta")
    row = next(row for row in table.rows if row[:2] == ("navigation, N = 3", GNN))
    without, with_term = (float(cell.split()[0]) for cell in row[2:])
    assert without == pytest.approx(0.4, abs=0.05)
    assert with_term == pytest.approx(0.6, abs=0.05)


def test_several_weights_of_the_term_are_one_training() -> None:
    pairs = [pair("attention", 3, weight, seed) for weight in (0.1, 0.2) for seed in range(3)]
    made = StudyData(STUDIES["main"], ("attention",), pairs, Samples.of(pairs))
    found = next(each for each in quality(made) if each["metric"] == "fid_delta")
    values = [entry.results[0].metrics.fid_delta for _, entry in pairs]
    means = np.array([value.value for value in values if value is not None], dtype=np.float64)
    clusters = Design(clusters=(0, 1, 2, 0, 1, 2))
    assert found["n_policies"] == 6
    assert found["interval"] == pytest.approx(interval_of(means, design=clusters), abs=1e-6)
    assert found["interval"] != pytest.approx(interval_of(means), abs=1e-4)


def test_figures_follow_the_colour_scheme(written: Path) -> None:
    drawn = sorted(path.name for path in (written / "figures").iterdir())
    assert {"fid_delta-paper.svg", "fid_delta-paper.pdf", "gef-paper.svg"} <= set(drawn)
    svg = (written / "figures" / "fid_delta-paper.svg").read_text()
    root = ElementTree.fromstring(svg)
    assert root.attrib["role"] == "img"
    assert "prefers-color-scheme:dark" in svg
    assert svg.count("currentColor") > 20
    assert svg.count(INK) == 1  # only in the style
    assert "navigation, N = 3" in svg
    assert "not measured" in svg  # the panels of the other cells
    assert (written / "figures" / "fid_delta-paper.pdf").read_bytes().startswith(b"%PDF")


def test_the_page_needs_no_other_file(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert not re.findall(
        r"""(?:src|href)=["'](?!#)[^"']+["']""", re.sub(r"<svg.*?</svg>", "", page, flags=re.S)
    )
    assert page.count("<svg") == len(list((written / "figures").glob("*.svg")))
    assert "Missing cells" in page
    assert "With the term AttentionExplainer has more FidDelta than GNNExplainer" in page


def test_results_contain_no_times(written: Path) -> None:
    text = (written / "results.json").read_text()
    assert "seconds" not in text
    assert "2026-" not in text
