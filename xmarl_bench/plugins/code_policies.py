"""Opens policies that are code: a PolicyModule, or what returns one, by reference or of a plugin."""

from __future__ import annotations

import hashlib
from importlib.metadata import EntryPoint

from pydantic import ValidationError
from safetensors.torch import save
from torch import nn

from xmarl_bench.errors import InputError, a_type, failures_named, whole_number
from xmarl_bench.origin.plugins import origin_of_plugin
from xmarl_bench.origin.references import Origin, load_reference
from xmarl_bench.plugins.names import places_of_plugin
from xmarl_bench.policy import CodeArchitecture, ModulePolicy, Policy, PolicyCard
from xmarl_bench.policy.interventions import check_interventions, random_teams
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.policy.tensors import check_tensors
from xmarl_bench.records.strict_json import first_error
from xmarl_bench.reproducible import torch_defaults
from xmarl_bench.tasks.sources import open_task


def run_policy(name: str, plugin: EntryPoint | None) -> tuple[Policy, PolicyCard]:
    """A policy that is code, of a plugin or by `module:factory`. Raises InputError if it cannot be made."""
    if plugin is None:
        factory, origin = load_reference(name)
        return open_module(_made(factory, name), origin)
    code = places_of_plugin(plugin).get(name)
    made = _made(code, name)
    if made.name != name:
        raise InputError(
            f"policy plugin {name!r} ({plugin.value}) calls itself {made.name!r}: use one name for both."
        )
    named = getattr(code, "__qualname__", None)
    where = None if named is None else f"{code.__module__}:{named}"
    return open_module(made, origin_of_plugin(plugin, where))


@torch_defaults()
def open_module(module: PolicyModule, origin: Origin) -> tuple[ModulePolicy, PolicyCard]:
    """The policy with its card, as `load_policy` returns them for a bundle.

    Raises InputError for an unknown task, a network that masks cannot explain (see ModulePolicy and
    xmarl_bench.policy.interventions), and an invalid name, team size or distribution.
    """
    if not isinstance(module.network, nn.Module):
        raise InputError(
            f"the network of policy {module.name!r} is {a_type(module.network)}: give a torch module."
        )
    if not (isinstance(module.task, str) or callable(module.task)):
        raise InputError(f"policy {module.name!r} has task {module.task!r}: give a name or a function.")
    n_agents = whole_number(f"n_agents of policy {module.name!r}", module.n_agents)
    check_tensors(module.network, module.name)
    # Whoever runs the policy's code runs that of its task.
    source = open_task(module.task, trust_code=True)
    task = source.make(n_agents).with_actions(module.distribution != "categorical")
    obs_dim, action_dim = task.obs_dim, task.action_width
    try:
        card = PolicyCard(
            name=module.name,
            task=source.name,
            n_agents=n_agents,
            attention_entropy=module.attention_entropy,
            training_seed=module.training_seed,
            architecture=CodeArchitecture(
                obs_dim=obs_dim,
                action_dim=action_dim,
                entry_point=origin.entry_point,
                package=origin.distribution,
                version=origin.version,
                code_sha256=origin.code_sha256,
                distribution=module.distribution,
                graph=module.graph,
            ),
            weights_sha256=_weights_sha256(module.network),
        )
    except ValidationError as error:
        problem, where = first_error(error)
        raise InputError(f"policy {module.name!r} has no valid {where}: {problem}.") from None
    policy = ModulePolicy(
        module.network,
        obs_dim,
        action_dim,
        distribution=module.distribution,
        graph=module.graph,
        n_agents=n_agents,
    )
    check_interventions(policy, random_teams(2, module.n_agents, obs_dim))
    return policy, card


def _made(factory: object, name: str) -> PolicyModule:
    """What the factory returns. Raises InputError if it fails or returns anything but a PolicyModule."""
    if not callable(factory):
        raise InputError(
            f"policy {name!r} is {a_type(factory)}: give a function that returns a PolicyModule."
        )
    with failures_named(f"policy {name!r} could not be made", "correct its factory"):
        made = factory()
    if not isinstance(made, PolicyModule):
        raise InputError(f"policy {name!r} is {a_type(made)}: make its factory return a PolicyModule.")
    return made


def _weights_sha256(network: nn.Module) -> str:
    """SHA-256 of the tensors as safetensors, also of buffers that are not saved.

    Tensors that share memory are written twice.
    """
    tensors = {**dict(network.named_buffers()), **network.state_dict()}
    state = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
    return hashlib.sha256(save(state)).hexdigest()
