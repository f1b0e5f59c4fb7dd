"""Trainings by BenchMARL on VMAS navigation, for tests of its checkpoints and as a peer of our trainer.

Needs BenchMARL, whose import takes some seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarl.algorithms import MappoConfig
from benchmarl.algorithms.common import AlgorithmConfig
from benchmarl.environments import VmasTask
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import GnnConfig, MlpConfig, SequenceModelConfig
from benchmarl.models.common import ModelConfig
from torch import nn
from torch_geometric.nn import GATv2Conv


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
    algorithm: AlgorithmConfig | None = None,
    callback: Callback | None = None,
    **task: object,
) -> Experiment:
    """A training of three agents, ready to run; with MAPPO by default.

    task: settings of the scenario that differ from BenchMARL's.
    """
    navigation = VmasTask.NAVIGATION.get_from_yaml()
    navigation.config |= {"n_agents": 3, **task}
    return Experiment(
        task=navigation,
        algorithm_config=algorithm or MappoConfig.get_from_yaml(),
        model_config=actor,
        critic_model_config=critic,
        seed=0,
        config=config,
        callbacks=[] if callback is None else [callback],
    )


def gnn(*, self_loops: bool, **arguments: object) -> GnnConfig:
    """BenchMARL's GNN on the complete graph, a GATv2Conv. arguments: of that layer."""
    return GnnConfig(topology="full", self_loops=self_loops, gnn_class=GATv2Conv, gnn_kwargs=arguments)


def mlp(widths: Sequence[int], activation: type[nn.Module] = nn.Tanh) -> MlpConfig:
    """BenchMARL's MLP. widths: of its hidden layers."""
    return MlpConfig(num_cells=list(widths), activation_class=activation, layer_class=nn.Linear)


def sequence(models: Sequence[ModelConfig], *between: int) -> SequenceModelConfig:
    """Models one after the other. between: width of what each passes to the next."""
    return SequenceModelConfig(model_configs=list(models), intermediate_sizes=list(between))
