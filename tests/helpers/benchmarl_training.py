"""Trainings by BenchMARL on VMAS navigation, for tests of its checkpoints and as a peer of our trainer.

Needs BenchMARL, whose import takes some seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarl import algorithms
from benchmarl.algorithms.common import AlgorithmConfig
from benchmarl.environments import VmasTask
from benchmarl.environments.vmas.common import VmasClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import GnnConfig, MlpConfig, SequenceModelConfig
from benchmarl.models.common import ModelConfig
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv
from torchrl.envs.libs.vmas import VmasEnv
from vmas.scenarios.navigation import Scenario
from vmas.simulator.core import Agent


def settings(folder: Path, **changes: object) -> ExperimentConfig:
    """BenchMARL's default settings of an experiment, without logs and checkpoints."""
    config = ExperimentConfig.get_from_yaml()
    folder.mkdir()
    quiet = {"loggers": [], "create_json": False, "render": False, "save_folder": str(folder)}
    for name, value in (quiet | changes).items():
        setattr(config, name, value)
    return config


def experiment(
    config: ExperimentConfig,
    actor: ModelConfig,
    critic: ModelConfig,
    *,
    by: AlgorithmConfig | None = None,
    callback: Callback | None = None,
    task: VmasClass | None = None,
) -> Experiment:
    """A training, ready to run; with MAPPO and on VMAS navigation by default."""
    return Experiment(
        task=navigation() if task is None else task,
        algorithm_config=by or algorithm("Mappo"),
        model_config=actor,
        critic_model_config=critic,
        seed=0,
        config=config,
        callbacks=[] if callback is None else [callback],
    )


def navigation(**changes: object) -> VmasClass:
    """VMAS navigation with three agents. changes: settings that differ from BenchMARL's."""
    task = VmasTask.NAVIGATION.get_from_yaml()
    task.config |= {"n_agents": 3, **changes}
    return task


class NamedObservations(Scenario):  # type: ignore[misc]
    """VMAS navigation whose observations are a dict of `pos`, `vel` and `goal`, without lidar."""

    def observation(self, agent: Agent) -> dict[str, Tensor]:
        pos, vel, goal = super().observation(agent).split(2, dim=-1)
        return {"pos": pos, "vel": vel, "goal": goal}


class NamedNavigation(VmasClass):  # type: ignore[misc]
    """BenchMARL's task of that scenario."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: str
    ) -> Callable[[], VmasEnv]:
        return lambda: VmasEnv(
            scenario=NamedObservations(),
            num_envs=num_envs,
            continuous_actions=continuous_actions,
            seed=seed,
            device=device,
            clamp_actions=True,
            **self.config,
        )


def named_navigation(**changes: object) -> VmasClass:
    """As `navigation`, with observations by name."""
    return NamedNavigation("NAVIGATION", navigation(**changes).config)


def algorithm(name: str) -> AlgorithmConfig:
    """BenchMARL's default settings of an algorithm, such as `Mappo`."""
    return getattr(algorithms, f"{name}Config").get_from_yaml()


def gnn(*, self_loops: bool, **arguments: object) -> GnnConfig:
    """BenchMARL's GNN on the complete graph, a GATv2Conv. arguments: of that layer."""
    return GnnConfig(topology="full", self_loops=self_loops, gnn_class=GATv2Conv, gnn_kwargs=arguments)


def mlp(widths: Sequence[int], activation: type[nn.Module] = nn.Tanh) -> MlpConfig:
    """BenchMARL's MLP. widths: of its hidden layers."""
    return MlpConfig(num_cells=list(widths), activation_class=activation, layer_class=nn.Linear)


def sequence(models: Sequence[ModelConfig], *between: int) -> SequenceModelConfig:
    """Models one after the other. between: width of what each passes to the next."""
    return SequenceModelConfig(model_configs=list(models), intermediate_sizes=list(between))
