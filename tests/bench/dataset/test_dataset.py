"""Datasets hold what an entry is computed from, have the same bytes each time, and execute nothing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from tests.conftest import RunCli, save_bundle
from tests.helpers.deep_policies import two_layers
from xmarl_bench import PolicyCard, load_policy, score
from xmarl_bench.dataset import planted_dataset, played_dataset, read_dataset, write_dataset
from xmarl_bench.dataset.card import MEANINGS
from xmarl_bench.errors import InputError
from xmarl_bench.metrics import prediction_change
from xmarl_bench.planted.families import planted
from xmarl_bench.policy.architecture import CodeArchitecture
from xmarl_bench.policy.graph import CompleteGraph
from xmarl_bench.rollout.cell import Cell

PAGE = (Path(__file__).parents[3] / "docs" / "dataset.md").read_text(encoding="utf-8")
SHORT = ("--max-cycles", 12, "--episodes", 3)


def exported(bundle: Path, out: Path, run_cli: RunCli, *options: object) -> bytes:
    assert run_cli("export", "--policy", bundle, "--out", out, *SHORT, *options).code == 0
    return (out / "small.safetensors").read_bytes()


@pytest.mark.slow
def test_the_page_computes_the_message_fidelity_of_an_entry(
    tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bundle = save_bundle(tmp_path)
    exported(bundle, tmp_path / "dataset", run_cli)
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    name = re.search(r"dataset/(\S+)\.safetensors", code)
    assert name is not None
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    exec(compile(code.replace(name[1], "small"), "dataset.md", "exec"), {})
    entry = score(str(bundle), "attention", episodes=3, max_cycles=12, behaviour_episodes=0)
    expected = entry.results[0].metrics.message_fidelity
    assert expected is not None
    assert float(capsys.readouterr().out) == pytest.approx(expected.value, abs=1e-5)


@pytest.mark.slow
def test_the_policy_beside_the_file_does_what_the_file_says(tmp_path: Path, run_cli: RunCli) -> None:
    exported(save_bundle(tmp_path), tmp_path / "d", run_cli)
    data = read_dataset(tmp_path / "d" / "small.safetensors")
    policy, _ = load_policy(tmp_path / "d" / "policies" / "small")
    arrays = {name: torch.from_numpy(array) for name, array in data.arrays.items()}
    with torch.no_grad():
        torch.testing.assert_close(policy.distribution(arrays["observation"]).action, arrays["action"])
        alone = policy.distribution(arrays["observation"], torch.eye(3)).action.numpy()
    rows = arrays["change"].numpy()[[1, 2, 4], :, [0, 1, 2]].T  # agent i hears itself alone: bit i
    np.testing.assert_allclose(rows, prediction_change(data.arrays["action"], alone, 2), atol=1e-6)
    assert list(np.unique(data.arrays["episode"])) == [0, 1, 2]
    assert set(data.arrays) <= set(MEANINGS)


@pytest.mark.slow
def test_a_policy_in_two_team_sizes_has_two_files(tmp_path: Path, run_cli: RunCli) -> None:
    exported(save_bundle(tmp_path), tmp_path / "d", run_cli, "--team", 3, "--team", 4)
    sizes = {path.stem: read_dataset(path).card.n_agents for path in (tmp_path / "d").glob("*.safetensors")}
    assert sizes == {"small": 3, "small-n4": 4}
    assert [path.name for path in (tmp_path / "d" / "policies").iterdir()] == ["small"]


def test_two_datasets_of_one_name_are_refused(tmp_path: Path, run_cli: RunCli) -> None:
    one, two = save_bundle(tmp_path), save_bundle(tmp_path, n_agents=4, name="small-n4")
    ran = run_cli("export", "--policy", one, "--policy", two, "--team", 4, "--out", tmp_path / "d")
    assert (ran.code, "two datasets would be small-n4: export one of them" in ran.err) == (2, True)
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    "wrong", [("--max-cycles", 0), ("--suite", "planted", "--seed", -1), ("--episodes", 0)]
)
def test_numbers_out_of_range_are_refused(wrong: tuple[object, ...], tmp_path: Path, run_cli: RunCli) -> None:
    ran = run_cli("export", *wrong, "--out", tmp_path / "d")
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert not (tmp_path / "d").exists()


@pytest.mark.slow
def test_the_card_lists_every_array_with_its_shape(tmp_path: Path, run_cli: RunCli) -> None:
    exported(save_bundle(tmp_path), tmp_path / "d", run_cli)
    page = (tmp_path / "d" / "small.md").read_text(encoding="utf-8")
    for name, array in load_file(tmp_path / "d" / "small.safetensors").items():
        assert f"| `{name}` | {array.dtype} | {' x '.join(map(str, array.shape))} |" in page


@pytest.mark.slow
def test_planted_files_hold_the_truth(tmp_path: Path, run_cli: RunCli) -> None:
    assert run_cli("export", "--suite", "planted", "--episodes", 5, "--out", tmp_path).code == 0
    truth = planted("decoy", 6, n_steps=5)
    data = read_dataset(tmp_path / "planted-decoy-n6.safetensors")
    np.testing.assert_array_equal(data.arrays["relevant"], truth.relevant)
    np.testing.assert_array_equal(data.arrays["counted"], truth.counted)
    policy, _ = load_policy(tmp_path / "policies" / "planted-decoy-n6")
    with torch.no_grad():
        action = policy.distribution(truth.observations).action.numpy()
    np.testing.assert_allclose(data.arrays["action"], action, atol=1e-6)


def test_a_policy_of_several_layers_has_no_tables() -> None:
    policy = two_layers(6)
    architecture = CodeArchitecture(
        obs_dim=6, entry_point="own:network", package=None, version=None, code_sha256=None,
        distribution="tanh_normal", graph=CompleteGraph(),
    )  # fmt: skip
    card = PolicyCard(
        name="deep", task="blind_navigation_v0", n_agents=3, attention_entropy=0.0, architecture=architecture,
        weights_sha256="0" * 64,
    )  # fmt: skip
    data = played_dataset(policy, card, Cell("blind_navigation_v0", 3), episodes=1, max_cycles=3)
    assert "observation" in data.arrays
    assert not [name for name in data.arrays if "change" in name]
    assert data.bundle is None


def test_a_file_without_a_card_is_refused(tmp_path: Path) -> None:
    save_file({"observation": np.zeros(3, dtype=np.float32)}, tmp_path / "x.safetensors")
    with pytest.raises(InputError, match="holds no card of a dataset"):
        read_dataset(tmp_path / "x.safetensors")


def test_a_cut_file_is_refused(tmp_path: Path) -> None:
    path = write_dataset(tmp_path, planted_dataset("decoy", 3, n_steps=2))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="cannot be read as safetensors"):
        read_dataset(path)
