"""Weights saved by other libraries are read without executing anything and give the same policy."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_baselines.training.recipes import recipe_for
from xmarl_baselines.training.trainer import Run, build

from tests.bench.policy.test_hostile_bundles import RAN, Payload
from tests.bench.policy.test_layers import GAT2, random_policy, record
from tests.conftest import Ran, RunCli
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy, LayeredArchitecture, complete_graph, load_policy
from xmarl_bench.policy.build import weights_of
from xmarl_bench.policy.convert import dense, read_tensors, rename

TASK = ("--task", "blind_navigation_v0")


def write(path: Path, value: object) -> Path:
    path.write_text(json.dumps(value))
    return path


def test_a_state_dict_of_torch_save(tmp_path: Path, run_cli: RunCli) -> None:
    policy = random_policy(record(GAT2))
    torch.save({"model": OrderedDict(weights_of(policy)), "epoch": 3}, tmp_path / "model.pt")
    architecture = write(tmp_path / "a.json", record(GAT2).model_dump())
    key_map = write(tmp_path / "m.json", {"model.": ""})
    ran = run_cli(
        "convert", tmp_path / "model.pt", "--out", tmp_path / "mine", *TASK, "--architecture", architecture,
        "--key-map", key_map, "--training-seed", 5,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    loaded, card = load_policy(tmp_path / "mine")
    assert (card.name, card.training_seed, card.architecture) == ("mine", 5, record(GAT2))
    observations = random_observations(3, 3, 6)
    with torch.no_grad():
        assert torch.equal(loaded.distribution(observations).loc, policy.distribution(observations).loc)
    assert "model.layers.0.att_src" in run_cli("convert", tmp_path / "model.pt").out


@pytest.mark.parametrize("residual", [False, True])
def test_a_state_dict_of_the_one_layer(residual: bool, tmp_path: Path, run_cli: RunCli) -> None:
    policy = small_policy(6, 2, residual=residual)
    torch.save(policy.state_dict(), tmp_path / "model.pt")
    architecture = write(tmp_path / "a.json", policy.architecture.model_dump())
    ran = run_cli(
        "convert", tmp_path / "model.pt", "--out", tmp_path / "mine", *TASK, "--architecture", architecture
    )
    assert ran.code == 0, ran.err
    loaded, card = load_policy(tmp_path / "mine")
    assert card.architecture == policy.architecture
    assert weights_of(loaded).keys() == policy.state_dict().keys()
    assert all(torch.equal(tensor, policy.state_dict()[name]) for name, tensor in weights_of(loaded).items())


@pytest.mark.parametrize("family", FAMILIES)
def test_a_checkpoint_of_xmarl_train(family: Family, tmp_path: Path, run_cli: RunCli) -> None:
    recipe = recipe_for("blind_discovery_v0", family=family, frames=64, n_envs=2, n_steps=4, batch_size=8)
    model = build(Run(recipe), seed=0)
    model.save(tmp_path / "checkpoint.zip")
    ran = run_cli("convert", tmp_path / "checkpoint.zip", "--out", tmp_path / "ppo", "--task", recipe.task)
    assert ran.code == 0, ran.err
    loaded, _ = load_policy(tmp_path / "ppo")
    assert loaded.architecture == model.policy.actor.architecture
    assert isinstance(loaded, GraphPolicy)
    assert loaded.architecture.residual is (family == "residual")
    observations = random_observations(3, 3, 5)
    with torch.no_grad():
        theirs = model.policy.actor.distribution(observations)
        torch.testing.assert_close(loaded.distribution(observations).loc, theirs.loc, rtol=0, atol=1e-6)


class TorchRLActor(nn.Module):
    """An actor as BenchMARL builds it: a graph layer, TorchRL's MLP for all agents and its head."""

    def __init__(self) -> None:
        from torchrl.modules import (
            MultiAgentMLP,
            NormalParamExtractor,
        )  # takes a second, and only this test needs it

        super().__init__()
        self.gnns = nn.ModuleList([GATv2Conv(6, 8)])
        self.mlp = MultiAgentMLP(
            8, 4, 3, centralized=False, share_params=True, num_cells=[9], activation_class=nn.Tanh
        )
        self.head = NormalParamExtractor()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        hidden = self.gnns[0](x, complete_graph(len(x)))
        loc, scale = self.head(self.mlp(hidden))
        return loc, scale


@pytest.mark.slow
def test_an_actor_of_torchrl(tmp_path: Path, run_cli: RunCli) -> None:
    torch.manual_seed(0)
    actor = TorchRLActor()
    torch.save({"actor": actor.state_dict()}, tmp_path / "actor.pt")
    architecture = LayeredArchitecture.model_validate(
        {
            "obs_dim": 6,
            "layers": ({"conv": "GATv2Conv", "width": 8, "activation": "identity"},),
            "decoder": (9,),
            "decoder_activation": "tanh",
            "scale": "torchrl",
        }
    )
    key_map = {"actor.gnns.0.": "layers.0.", "actor.mlp.params.": "decoder.", "actor.mlp.params.__": None}
    ran = run_cli(
        "convert", tmp_path / "actor.pt", "--out", tmp_path / "rl", *TASK,
        "--architecture", write(tmp_path / "a.json", architecture.model_dump()),
        "--key-map", write(tmp_path / "m.json", key_map),
    )  # fmt: skip
    assert ran.code == 0, ran.err
    policy, _ = load_policy(tmp_path / "rl")
    x = random_observations(1, 3, 6)
    with torch.no_grad():
        loc, scale = actor(x[0])
        ours = policy.distribution(x)
    torch.testing.assert_close(ours.loc[0], loc, rtol=0, atol=1e-5)
    torch.testing.assert_close(ours.scale[0], scale, rtol=0, atol=1e-5)


WRAPPED = {
    "compiled": "_orig_mod.{}",
    "in DataParallel": "module.{}",
    "both": "module._orig_mod.{}",
    "in a checkpoint": "state_dict.actor.{}",
}


def convert(run_cli: RunCli, tmp_path: Path, tensors: object, architecture: Any, *more: object) -> Ran:
    torch.save(tensors, tmp_path / "model.pt")
    record = write(tmp_path / "a.json", architecture.model_dump())
    return run_cli(
        "convert", tmp_path / "model.pt", "--out", tmp_path / "mine", *TASK, "--architecture", record, *more
    )


@pytest.mark.parametrize("form", WRAPPED.values(), ids=WRAPPED)
def test_prefixes_are_recognised(form: str, tmp_path: Path, run_cli: RunCli) -> None:
    weights = weights_of(random_policy(record(GAT2)))
    renamed = {form.format(name): tensor for name, tensor in weights.items()}
    critic = {"critic.0.weight": torch.ones(1, 6)} if "actor" in form else {}
    ran = convert(run_cli, tmp_path, renamed | critic, record(GAT2))
    assert ran.code == 0, ran.err
    assert f"of {len(weights)} tensors, {len(critic)} dropped" in ran.out
    loaded = weights_of(load_policy(tmp_path / "mine")[0])
    assert all(torch.equal(loaded[name], tensor) for name, tensor in weights.items())


def test_a_compiled_part_is_recognised(tmp_path: Path, run_cli: RunCli) -> None:
    policy = small_policy(6, 2)
    weights = {name.replace("gat.", "gat._orig_mod."): t for name, t in policy.state_dict().items()}
    assert any("_orig_mod" in name for name in weights)
    assert convert(run_cli, tmp_path, weights, policy.architecture).code == 0


def test_without_a_key_map_the_expected_tensors_are_named(tmp_path: Path, run_cli: RunCli) -> None:
    weights = weights_of(random_policy(record(GAT2)))
    other = {name.replace("layers.0", "net.conv"): tensor for name, tensor in weights.items()}
    ran = convert(run_cli, tmp_path, other, record(GAT2))
    assert ran.code == 2
    for name in ("layers.0.att_src (1, ", "net.conv.att_src", "--key-map"):
        assert name in ran.err
    ran = convert(run_cli, tmp_path, weights | {"layers.9.bias": torch.ones(2)}, record(GAT2))
    assert ran.code == 2
    assert "has no tensor layers.9.bias" in ran.err
    wrapped = {f"module.{name}": tensor for name, tensor in weights.items()}
    ran = convert(run_cli, tmp_path, wrapped | {"module.layers.9.bias": torch.ones(2)}, record(GAT2))
    assert "has no tensor module.layers.9.bias" in ran.err  # as a key map names it
    two = {f"{net}.{name}": t for net in ("module.actor", "target") for name, t in weights.items()}
    ran = convert(run_cli, tmp_path, two, record(GAT2))
    assert ran.code == 2
    assert "'module.actor.', 'target.' all fit" in ran.err
    assert not (tmp_path / "mine").exists()
    listed = run_cli("convert", tmp_path / "model.pt", "--architecture", tmp_path / "a.json").out
    assert listed.count("layers.0.att_src") == 3  # of two networks, and the expected one


def test_a_bundle_that_its_task_cannot_take_is_refused(tmp_path: Path, run_cli: RunCli) -> None:
    weights = weights_of(random_policy(record(GAT2)))
    for more, said in (
        (["--task", "blind_passage_v0"], "takes observations of 6 entries, blind_passage_v0 gives 8"),
        (["--agents", 65], "blind_navigation_v0 takes 1 to 64 agents, got 65"),
    ):
        ran = convert(run_cli, tmp_path, weights, record(GAT2), *more)
        assert ran.code == 2
        assert said in ran.err
        assert not (tmp_path / "mine").exists()


def test_a_folder_that_exists_is_kept(tmp_path: Path, run_cli: RunCli) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "policy.json").write_text("earlier")
    ran = convert(run_cli, tmp_path, weights_of(random_policy(record(GAT2))), record(GAT2))
    assert ran.code == 2
    assert f"{tmp_path / 'mine'} already exists" in ran.err
    assert (tmp_path / "mine" / "policy.json").read_text() == "earlier"


def hostile(kind: str, path: Path) -> Path:
    if kind == "pickle":
        path.write_bytes(pickle.dumps(Payload()))
    elif kind == "old format":
        torch.save({"a": torch.ones(2)}, path, _use_new_zipfile_serialization=False)
    elif kind == "payload":
        torch.save({"a": Payload()}, path)
    elif kind == "payload in sb3":
        inner = io.BytesIO()
        torch.save({"a": Payload()}, inner)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("policy.pth", inner.getvalue())
            archive.writestr("data", "{}")
    elif kind == "bomb":
        inner = io.BytesIO()
        torch.save({"a": torch.zeros(1)}, inner)
        with zipfile.ZipFile(inner) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
            for name in old.namelist():
                new.writestr(name, bytes(2**26) if name.endswith("data/0") else old.read(name))
    elif kind == "text":
        path.write_text("hello")
    return path


@pytest.mark.parametrize(
    "kind", ["pickle", "old format", "payload", "payload in sb3", "bomb", "text", "gone"]
)
def test_files_with_more_than_weights_are_refused(kind: str, tmp_path: Path, run_cli: RunCli) -> None:
    path = hostile(kind, tmp_path / "x.pt")
    ran = run_cli("convert", path, "--out", tmp_path / "out", *TASK)
    assert ran.code == 2
    assert len(ran.err.splitlines()) == 1, ran.err
    assert RAN == []
    assert not (tmp_path / "out").exists()


def test_pickles_beside_a_checkpoint_s_weights_are_not_loaded(tmp_path: Path) -> None:
    inner = io.BytesIO()
    torch.save({"actor.x": torch.ones(2)}, inner)
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        archive.writestr("policy.pth", inner.getvalue())
        archive.writestr("pytorch_variables.pth", pickle.dumps(Payload()))
        archive.writestr("data", pickle.dumps(Payload()))
    assert read_tensors(tmp_path / "c.zip").keys() == {"actor.x"}
    assert RAN == []


def test_key_maps_by_hand() -> None:
    tensors = {"a.x": torch.ones(1), "a.b.y": torch.ones(2), "c": torch.ones(3, dtype=torch.long)}
    assert rename(tensors, {"a.": "p.", "a.b.": "q.", "c": None}).keys() == {"p.x", "q.y"}
    for key_map, said in (
        ({"a.": "p."}, "matches tensor 'c'"),
        ({"a.x": "same", "a.b.y": "same", "c": None}, "two tensors 'same'"),
        ({"": ""}, "'c' does not hold dense"),
    ):
        with pytest.raises(InputError, match=said):
            rename(tensors, key_map)


def test_a_tensor_with_a_false_size_is_not_copied() -> None:
    huge = torch.zeros(1).expand(2**40)
    assert dense({"w": huge}, {"w": (3,)})["w"] is huge
    with pytest.raises(InputError, match="NaN"):
        dense({"w": torch.full((3,), torch.nan)}, {"w": (3,)})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "give --architecture"),
        ({"--architecture": {"kind": "code"}}, "is not an architecture"),
        ({"--architecture": "x"}, "is not an architecture"),
        ({"--architecture": None, "--key-map": {"a": 1}}, "is not a key map"),
        ({"--architecture": None, "--key-map": []}, "is not a key map"),
        ({"--architecture": None}, "do not fit the architecture"),
        ({"--architecture": None, "--agents": 0}, "n_agents is invalid"),
    ],
)
def test_invalid_options_are_refused(
    options: dict[str, Any], said: str, tmp_path: Path, run_cli: RunCli
) -> None:
    weights = weights_of(random_policy(record(GAT2)))
    if "do not fit" in said:
        weights["layers.0.bias"] = torch.zeros(3)
    torch.save(weights, tmp_path / "w.pt")
    arguments: list[object] = []
    for name, value in options.items():
        value = record(GAT2).model_dump() if value is None else value
        arguments += [name, value if name == "--agents" else write(tmp_path / f"{name}.json", value)]
    ran = run_cli("convert", tmp_path / "w.pt", "--out", tmp_path / "out", *TASK, *arguments)
    assert ran.code == 2
    assert said in ran.err
    assert not (tmp_path / "out").exists()
