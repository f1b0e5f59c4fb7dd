"""Checkpoints of BenchMARL become bundles that act as BenchMARL's own actor."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import pool as nn_pool

from tests.conftest import RunCli
from tests.helpers.policies import random_observations
from xmarl_bench.errors import InputError
from xmarl_bench.policy import LayeredArchitecture, Policy, RadiusGraph, build_policy, load_policy
from xmarl_bench.policy.benchmarl import Settings, read_actor
from xmarl_bench.policy.convert import dense, read_tensors
from xmarl_bench.policy.shapes import weight_shapes

ACTOR = "loss_agents.actor_network_params.module.0.module.0."
GNN = f"{ACTOR}models.module.0.gnns.0."
MLP = f"{ACTOR}models.module.1.mlp.params."
TASK = ("--task", "blind_navigation_v0")
TANH = Settings(activation="tanh", loops="layer")


class Trained(NamedTuple):
    """A checkpoint, and the actor that BenchMARL has after writing it."""

    checkpoint: Path
    actor: Any
    by_name: bool  # its observations are a dict

    def act(self, x: Tensor) -> dict[str, Tensor]:
        """(S, N, D) -> BenchMARL's deterministic action and its distribution's parameters."""
        from tensordict import TensorDict
        from torchrl.envs.utils import ExplorationType, set_exploration_type

        named = {"pos": x[..., :2], "vel": x[..., 2:4], "goal": x[..., 4:]}
        seen = {"observation": named if self.by_name else x}
        given = TensorDict({"agents": TensorDict(seen, x.shape[:2])}, x.shape[:1])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return dict(self.actor(given)["agents"].items())


def trained(
    folder: Path, actor: Any, algorithm: Any = None, *, by_name: bool = False, **changes: Any
) -> Trained:
    """60 frames on VMAS navigation without lidar, and an update with a large step.

    by_name: observations are a dict of `pos`, `vel` and `goal`.
    """
    from tests.helpers import benchmarl_training as benchmarl

    few = {"collected_frames_per_batch": 60, "n_envs_per_worker": 2}
    config = benchmarl.settings(
        folder,
        **{f"{kind}_policy_{name}": value for name, value in few.items() for kind in ("on", "off")},
        on_policy_n_minibatch_iters=1,
        on_policy_minibatch_size=30,
        off_policy_n_optimizer_steps=1,
        off_policy_train_batch_size=10,
        off_policy_memory_size=100,
        lr=0.01,
        max_n_iters=1,
        max_n_frames=None,
        evaluation=False,
        checkpoint_at_end=True,
        **changes,
    )
    critic = benchmarl.mlp([8])
    task = benchmarl.named_navigation if by_name else benchmarl.navigation
    run = benchmarl.experiment(config, actor, critic, by=algorithm, task=task(collisions=False))
    run.run()
    (checkpoint,) = folder.rglob("checkpoint_60.pt")
    return Trained(checkpoint, run.group_policies["agents"], by_name)


def read(checkpoint: Path, settings: Settings) -> tuple[LayeredArchitecture, Policy]:
    record, weights = read_actor(read_tensors(checkpoint), settings, 6)
    return record, build_policy(record, dense(weights, weight_shapes(record)))


def assert_equal_actors(policy: Policy, theirs: Trained) -> None:
    x = random_observations(40, 3, 6)
    expected = theirs.act(x)
    with torch.no_grad():
        ours = policy.distribution(x)
    assert expected["loc"].std() > 0.01
    torch.testing.assert_close(ours.loc, expected["loc"], rtol=0, atol=1e-5)
    torch.testing.assert_close(ours.scale, expected["scale"], rtol=0, atol=1e-5)
    if ours.kind == "tanh_normal":
        torch.testing.assert_close(ours.action, expected["action"], rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.training
@pytest.mark.parametrize("loops", ["layer", "none"])
def test_the_command_converts_a_checkpoint(loops: str, tmp_path: Path, run_cli: RunCli) -> None:
    """GATv2Conv adds self loops to a graph that has none, unless it is told not to."""
    benchmarl = helper()
    alone = {} if loops == "layer" else {"add_self_loops": False}
    actor = benchmarl.sequence([benchmarl.gnn(self_loops=False, **alone), benchmarl.mlp([16])], 8)
    theirs = trained(tmp_path / "run", actor)
    ran = run_cli(
        "convert", theirs.checkpoint, "--from", "benchmarl", "--out", tmp_path / "mine", *TASK,
        "--activation", "tanh", "--loops", loops,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    policy, card = load_policy(tmp_path / "mine")
    assert_equal_actors(policy, theirs)
    assert card.architecture.graph.loops is (loops == "layer")
    assert card.training == {"converted_from": "checkpoint_60.pt", "library": "benchmarl"}


@pytest.mark.slow
@pytest.mark.training
def test_the_configuration_of_the_experiment_replaces_options(tmp_path: Path, run_cli: RunCli) -> None:
    benchmarl = helper()
    algorithm = benchmarl.algorithm("Mappo")
    algorithm.scale_mapping = "softplus"
    layer = benchmarl.gnn(self_loops=False, add_self_loops=False)
    actor = benchmarl.sequence([layer, benchmarl.mlp([16], nn.ELU)], 8)
    theirs = trained(tmp_path / "run", actor, algorithm)
    assert (theirs.checkpoint.parent.parent / "config.pkl").exists()
    ran = run_cli("convert", theirs.checkpoint, "--from", "benchmarl", "--out", tmp_path / "mine", *TASK)
    assert ran.code == 0, ran.err
    policy, card = load_policy(tmp_path / "mine")
    assert isinstance(card.architecture, LayeredArchitecture)
    assert (card.architecture.decoder_activation, card.architecture.graph.loops) == ("elu", False)
    assert_equal_actors(policy, theirs)


@pytest.mark.slow
@pytest.mark.training
def test_a_gnn_alone(tmp_path: Path) -> None:
    actor = helper().gnn(self_loops=True, heads=2, concat=False, residual=True)
    theirs = trained(tmp_path / "run", actor)
    record, policy = read(theirs.checkpoint, Settings(loops="layer"))
    assert (record.layers[0].heads, record.layers[0].residual, record.decoder) == (2, True, ())
    assert_equal_actors(policy, theirs)


@pytest.mark.slow
@pytest.mark.training
def test_mlps_around_two_gnns_and_another_distribution(tmp_path: Path) -> None:
    benchmarl = helper()
    layers = [
        benchmarl.gnn(self_loops=False, add_self_loops=False, residual=True),
        benchmarl.gnn(self_loops=False, add_self_loops=False, bias=False),
    ]
    before, after = benchmarl.mlp([12], nn.ReLU), benchmarl.mlp([9, 7], nn.ReLU)
    algorithm = benchmarl.algorithm("Mappo")
    algorithm.use_tanh_normal, algorithm.scale_mapping = False, "biased_softplus_0.5"
    theirs = trained(tmp_path / "run", benchmarl.sequence([before, *layers, after], 5, 8, 6), algorithm)
    record, policy = read(theirs.checkpoint, Settings("relu", "none", "biased_softplus_0.5", False))
    assert (record.encoder, [layer.width for layer in record.layers]) == ((12,), [8, 6])
    assert (record.decoder, record.distribution) == ((9, 7), "normal")
    assert_equal_actors(policy, theirs)


@pytest.mark.slow
@pytest.mark.training
@pytest.mark.parametrize("loops", ["layer", "graph", "none"])
def test_edge_features_of_positions_and_velocities(loops: Any, tmp_path: Path) -> None:
    """BenchMARL gets observations by name, and its GNN puts position and velocity behind the others."""
    benchmarl = helper()
    keys = {"position_key": "pos", "pos_features": 2, "velocity_key": "vel", "vel_features": 2}
    layer = benchmarl.gnn(self_loops=loops == "graph", add_self_loops=loops == "layer", residual=True)
    for name, value in {**keys, "exclude_pos_from_node_features": loops == "none"}.items():
        setattr(layer, name, value)
    theirs = trained(tmp_path / "run", benchmarl.sequence([layer, benchmarl.mlp([16])], 8), by_name=True)
    inputs = (4, 5, 2, 3) if loops == "none" else (4, 5, 0, 1, 2, 3)
    settings = Settings("tanh", loops, inputs=inputs, position=(0, 1), velocity=(2, 3), radius=inf)
    record, policy = read(theirs.checkpoint, settings)
    assert record.layers[0].edges is not None
    assert record.layers[0].edges.own == ("mean" if loops == "layer" else "zero")
    assert record.obs_dim == 6
    assert_equal_actors(policy, theirs)


@pytest.mark.slow
@pytest.mark.training
@pytest.mark.parametrize("loops", ["layer", "none"])
def test_the_topology_from_positions(
    loops: Any, tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BenchMARL searches neighbours with pyg-lib, which is not on PyPI."""
    monkeypatch.setattr(nn_pool, "radius_graph", near)
    benchmarl = helper()
    layer = benchmarl.gnn(self_loops=False, add_self_loops=loops == "layer", residual=True)
    layer.topology, layer.edge_radius = "from_pos", 1.5
    layer.position_key, layer.pos_features, layer.exclude_pos_from_node_features = "pos", 2, False
    theirs = trained(tmp_path / "run", layer, by_name=True)
    ran = run_cli(
        "convert", theirs.checkpoint, "--from", "benchmarl", "--out", tmp_path / "mine", *TASK,
        "--inputs", "4,5,2,3,0,1", "--position", "0,1",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    policy, card = load_policy(tmp_path / "mine")
    assert card.architecture.graph == RadiusGraph(radius=1.5, loops=loops == "layer")
    adjacency = policy.adjacency(random_observations(40, 3, 6))
    assert adjacency is not None
    assert 0.2 < adjacency.float().mean() < 0.8
    assert_equal_actors(policy, theirs)


def near(pos: Tensor, r: float, batch: Tensor, loop: bool) -> Tensor:
    """(n, 2) -> (2, edges) of torch_geometric's `radius_graph`: neighbours within r in the same team."""
    there = (torch.cdist(pos, pos) <= r) & (batch[:, None] == batch[None])
    return (there & (loop | ~torch.eye(len(pos), dtype=torch.bool))).nonzero().T


@pytest.mark.slow
@pytest.mark.training
def test_discrete_actions(tmp_path: Path) -> None:
    benchmarl = helper()
    actor = benchmarl.sequence([benchmarl.gnn(self_loops=True), benchmarl.mlp([16])], 8)
    theirs = trained(tmp_path / "run", actor, prefer_continuous_actions=False)
    record, policy = read(theirs.checkpoint, TANH)
    assert (record.distribution, record.action_dim) == ("categorical", 9)
    x = random_observations(40, 3, 6)
    expected = theirs.act(x)
    with torch.no_grad():
        ours = policy.distribution(x)
    torch.testing.assert_close(ours.action, expected["logits"].softmax(dim=-1), rtol=0, atol=1e-5)
    assert torch.equal(ours.choice, expected["action"])


@pytest.mark.slow
@pytest.mark.training
@pytest.mark.parametrize("name", ["Ippo", "Masac", "Isac"])
def test_other_algorithms_with_a_distribution(name: str, tmp_path: Path) -> None:
    benchmarl = helper()
    actor = benchmarl.sequence([benchmarl.gnn(self_loops=True), benchmarl.mlp([16])], 8)
    theirs = trained(tmp_path / "run", actor, benchmarl.algorithm(name))
    assert_equal_actors(read(theirs.checkpoint, TANH)[1], theirs)


@pytest.mark.slow
@pytest.mark.training
@pytest.mark.parametrize("name", ["Maddpg", "Iddpg"])
def test_deterministic_actions(name: str, tmp_path: Path) -> None:
    benchmarl = helper()
    actor = benchmarl.sequence([benchmarl.gnn(self_loops=True), benchmarl.mlp([16])], 8)
    theirs = trained(tmp_path / "run", actor, benchmarl.algorithm(name))
    record, policy = read(theirs.checkpoint, TANH)
    assert (record.distribution, record.action_dim) == ("deterministic", 2)
    x = random_observations(40, 3, 6)
    with torch.no_grad():
        torch.testing.assert_close(policy.distribution(x).action, theirs.act(x)["action"], rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.training
def test_parameters_of_each_agent_are_refused(tmp_path: Path) -> None:
    theirs = trained(tmp_path / "run", helper().gnn(self_loops=True), share_policy_params=False)
    with pytest.raises(InputError, match="share_policy_params=True"):
        read(theirs.checkpoint, TANH)


def helper() -> Any:
    """Skips if BenchMARL is not installed, or does not work with the installed TorchRL."""
    pytest.importorskip("benchmarl", reason="install the extra `bench` for BenchMARL", exc_type=ImportError)
    from tests.helpers import benchmarl_training

    return benchmarl_training


def checkpoint(**changes: tuple[int, ...] | None) -> dict[str, Tensor]:
    """The tensors of a small checkpoint. changes: further shapes by name, None to leave a tensor out."""
    shapes: dict[str, tuple[int, ...] | None] = {
        **{f"{GNN}{name}": (8,) for name in ("bias", "lin_l.bias", "lin_r.bias")},
        **{f"{GNN}{name}": (8, 6) for name in ("lin_l.weight", "lin_r.weight")},
        f"{GNN}att": (1, 1, 8),
        **{f"{MLP}0.weight": (16, 8), f"{MLP}0.bias": (16,), f"{MLP}2.weight": (4, 16), f"{MLP}2.bias": (4,)},
        "loss_agents.critic_network_params.module.0.mlp.params.0.weight": (8, 18),
        "buffer_agents._storage._storage.index": (60,),
        **changes,
    }
    generator = torch.Generator().manual_seed(0)
    return {n: torch.randn(shape, generator=generator) for n, shape in shapes.items() if shape is not None}


def test_the_record_of_a_checkpoint() -> None:
    record, weights = read_actor(checkpoint(), TANH, 6)
    assert (record.obs_dim, record.action_dim, record.decoder, record.scale) == (6, 2, (16,), "torchrl")
    assert {name: tuple(tensor.shape) for name, tensor in weights.items()} == weight_shapes(record)


def test_scale_mappings_by_hand() -> None:
    """Each maps a raw scale of 0 to the number in its name, softplus to log(2)."""
    silent = {name: torch.zeros_like(tensor) for name, tensor in checkpoint().items()}
    for mapping, scale in (("softplus", 0.693147), ("biased_softplus", 1.0), ("biased_softplus_0.3", 0.3)):
        record, weights = read_actor(silent, TANH._replace(scale_mapping=mapping), 6)
        found = build_policy(record, weights).distribution(torch.zeros(1, 3, 6))
        torch.testing.assert_close(found.scale, torch.full((1, 3, 2), scale), rtol=0, atol=1e-6)
        assert not found.loc.any()


SECOND_GNN = {
    name.replace("models.module.0", "models.module.2"): (8, 4) if tensor.dim() == 2 else tuple(tensor.shape)
    for name, tensor in checkpoint().items()
    if name.startswith(GNN)
}
PLACED = TANH._replace(inputs=tuple(range(6)), position=(0, 1), radius=1.0)
EDGES = {f"{GNN}lin_edge.weight": (8, 3)}
REFUSED: dict[str, tuple[Mapping[str, tuple[int, ...] | None], Settings, str]] = {
    "activation": ({}, Settings(loops="layer"), "give --activation"),
    "unknown activation": ({}, Settings("gelu", "layer"), "no activation function 'gelu': choose"),
    "loops": ({}, Settings("tanh"), "give --loops layer, "),
    "scale": ({}, TANH._replace(scale_mapping="exp"), "no scale mapping 'exp'"),
    "scale of 0": ({}, TANH._replace(scale_mapping="biased_softplus_0.01"), "no scale mapping"),
    "group": ({}, TANH._replace(group="foxes"), "no group 'foxes': give --group, one of 'agents'"),
    "groups": ({"loss_foxes.actor_network_params.module.0.x": (2,)}, TANH, "one of 'agents, foxes'"),
    "edge features": (EDGES, TANH, "give --position and --velocity"),
    "their width": (EDGES, PLACED._replace(velocity=(2, 3)), "gets 3 numbers .* give 5"),
    "their entries": (EDGES, PLACED._replace(position=(0, 6)), "need entry 6 of an observation of 6"),
    "topology": (EDGES, PLACED._replace(radius=None), "give --radius, the edge_radius of from_pos, or"),
    "radius": (EDGES, PLACED._replace(radius=-1.0), "--radius is -1: give a distance above 0"),
    "radius of nothing": ({}, TANH._replace(radius=1.0), "only for a GNN that gets positions"),
    "inputs": ({}, TANH._replace(inputs=(0, 6)), r"--inputs has entries .* from 0 to 5"),
    "other layer": ({f"{GNN}lin_rel.weight": (8, 6)}, TANH, "not those of GATv2Conv or GATConv"),
    "other model": ({f"{ACTOR}models.module.2.cnn.0.weight": (2,)}, TANH, "belongs to no GNN or MLP"),
    "own MLPs": ({f"{MLP}0.weight": (3, 16, 8)}, TANH, "share_policy_params=True"),
    "own GNNs": ({f"{GNN}att".replace("gnns.0", "gnns.1"): (1, 1, 8)}, TANH, "share_policy_params=True"),
    "normalised": ({f"{MLP}1.weight": (16,), f"{MLP}1.bias": (16,)}, TANH, "norm_class"),
    "no GNN": ({name: None for name in checkpoint() if name.startswith(GNN)}, TANH, "has no GNN"),
    "between": (SECOND_GNN, TANH, "an MLP between two GNNs"),
    "wide": ({f"{MLP}0.weight": (4097, 8), f"{MLP}0.bias": (4097,)}, TANH, "more than 4096 rows"),
    "bounds": ({f"{MLP}0.weight": (2049, 8), f"{MLP}0.bias": (2049,)}, TANH, "'decoder.0' is out of bounds"),
    "vectors": ({f"{GNN}lin_l.weight": (8,)}, TANH, r"has shape \(8,\)"),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "settings", "said"), REFUSED.values(), ids=REFUSED)
def test_refused_with_one_sentence(
    changes: Mapping[str, tuple[int, ...] | None], settings: Settings, said: str
) -> None:
    with pytest.raises(InputError, match=said) as refused:
        read_actor(checkpoint(**changes), settings, 6)
    assert "\n" not in str(refused.value)


def test_files_of_others_and_wrong_widths_are_refused(tmp_path: Path, run_cli: RunCli) -> None:
    for name, tensors, said in (
        ("other", {"layers.0.bias": torch.zeros(2)}, "has no actor of BenchMARL"),
        ("odd", checkpoint(**{f"{MLP}0.weight": (16, 9)}), "do not fit the architecture"),
    ):
        torch.save(tensors, tmp_path / f"{name}.pt")
        ran = run_cli(
            "convert", tmp_path / f"{name}.pt", "--from", "benchmarl", "--out", tmp_path / "out", *TASK,
            "--activation", "tanh", "--loops", "layer",
        )  # fmt: skip
        assert (ran.code, len(ran.err.splitlines())) == (2, 1)
        assert said in ran.err
        assert not (tmp_path / "out").exists()


def test_options_of_the_reader_need_it(tmp_path: Path, run_cli: RunCli) -> None:
    torch.save(checkpoint(), tmp_path / "c.pt")
    options = ("convert", tmp_path / "c.pt", "--out", tmp_path / "out", *TASK)
    assert "are for --from benchmarl" in run_cli(*options, "--position", "0,1").err
    assert "not a list of entries" in run_cli(*options, "--from", "benchmarl", "--inputs", "0,x").err
    assert "leave out --architecture" in run_cli(*options, "--from", "benchmarl", "--key-map", "k").err
