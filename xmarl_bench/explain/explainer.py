"""The explainer interface, and how the harness runs explainers.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
from torch import Tensor

from xmarl_bench.errors import InputError, failures_named
from xmarl_bench.explain.declarations import DECLARATIONS, Access, Scalar, check_declared
from xmarl_bench.explain.effect import signed_to_unit
from xmarl_bench.explain.node_importance import as_edge_masks
from xmarl_bench.explain.pyg import class_settings_kept
from xmarl_bench.explain.returned_mask import as_floats, checked_mask, finite
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.references import Origin
from xmarl_bench.policy import Policy
from xmarl_bench.policy.black_box import BlackBox
from xmarl_bench.policy.device import CPU, checked_device
from xmarl_bench.policy.elsewhere import PolicyElsewhere
from xmarl_bench.reproducible import derived_seed, one_thread, seeded, timestep_seeds


class Explain(Protocol):
    """Computes how much each message matters."""

    def __call__(self, policy: Policy, observations: Tensor, generator: torch.Generator, /) -> Tensor:
        """(S, N, D) float32 observations of one episode -> mask (S, N, N) in [0, 1], or what becomes one.

        mask[s, i, j] is how much edge j -> i (sender j, receiver i; the diagonal is the agent's own edge)
        matters at timestep s. `policy` is a private copy; all randomness must come from `generator`. The
        last `policy.memory_dim` of the D entries are what an agent remembers at that timestep.
        """


class Elsewhere(Protocol):
    """An explainer in a process of its own, which does there what `run_explainer` and `fit_explainer` do."""

    @property
    def key(self) -> str:
        """What its code and declarations are hashed to."""

    def explain(
        self, policy: Policy, observations: Tensor, seed: int, simulator: Simulator | None, /
    ) -> Tensor:
        """(S, N, D) -> (S, N, N): the mask, in [0, 1] unless it is wrong."""

    def on_device(self, device: str, /) -> Elsewhere:
        """The same explainer, computing there."""

    def fit(self, policy: Policy, observations: Tensor, seed: int, /) -> Elsewhere:
        """The explainer fitted to the policy on (S, N, D) observations."""


# (policy, observations (S, N, D) that no score uses, generator) -> what explains this policy.
Fit = Callable[[Policy, Tensor, torch.Generator], Explain]


@dataclass(frozen=True)
class Explainer:
    """An explainer: the callable and its declarations.

    An entry records the declarations, and the harness acts on them. Third parties register an Explainer, or
    anything that `as_explainer` accepts, in the entry-point group `xmarl_bench.explainers`, by the same name.
    Raises InputError if an entry cannot record a hyperparameter.
    """

    name: str
    explain: Explain
    summary: str = ""  # one line
    stochastic: bool = False  # another seed gives another mask
    slow: bool = False  # more than about 10 ms per timestep: a run may give it fewer episodes
    control: bool = False  # not an explanation but a reference to compare explanations with
    hyperparameters: Mapping[str, Scalar] = field(default_factory=dict)
    batched: bool = True  # False: `explain` is called for one timestep at a time, (N, D) -> (N, N)
    binary: bool = False  # masks hold zeros and ones only, which is checked
    signed: bool = False  # returns finite numbers of either sign, which `signed_to_unit` maps to [0, 1]
    # Returns the importance of each agent as a sender, (S, N), of which `as_edge_masks` makes masks; None:
    # not declared, the shape tells.
    node_importance: bool | None = None
    simulates: bool = False  # plays on from the states that it explains: `explain` takes a simulator, too
    # Access to the policy. "black-box": a policy that only answers queries (policy.black_box); "attention":
    # the same with attention; "gradients", or None (not declared): the network itself.
    accesses: Access | None = None
    # The absence model under which it removes messages; None: it removes none, or does not declare it.
    absence: Absence | None = None
    # It computes on the device of its observations. Its generator draws on the CPU, whatever the device.
    any_device: bool = False
    device: str = CPU  # chosen by the run, with `on_device`
    fit: Fit | None = None  # learns once per policy, from states that no score uses
    fitted_on: Tensor | None = field(default=None, compare=False, repr=False)  # (S, N, D)
    simulator: Simulator | None = field(default=None, compare=False, repr=False)  # of the episode explained
    # Set if it was found by name; None for an object passed in Python, see `origin_of_explainer`.
    origin: Origin | None = field(default=None, compare=False, repr=False)
    # What asks it, if it runs in a process of its own; None: it runs in this process.
    elsewhere: Elsewhere | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        check_declared(self.name, {key: getattr(self, key) for key in DECLARATIONS if hasattr(self, key)})


def run_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Tensor:
    """(S, N, D) -> (S, N, N): the checked mask of one episode, a function of the arguments only.

    The explainer gets copies, so it cannot change the policy. The global random states of torch, numpy and
    Python are seeded, for explainers that ignore their generator, and restored afterwards, together with the
    settings that PyG's algorithms keep on their class. Raises InputError, naming the explainer, if it fails.
    """
    n_steps, n_agents, _ = observations.shape
    elsewhere = elsewhere_of(explainer, policy)
    if elsewhere is None:
        returned = returned_by(explainer, policy, observations, seed)
    else:
        returned = elsewhere.explain(policy, observations, seed, explainer.simulator)
        explainer = replace(explainer, signed=False)  # its process has mapped it to [0, 1]
    return on_graph(mask_of_explainer(explainer, returned, n_steps, n_agents), policy, observations)


def on_graph(mask: Tensor, policy: Policy, observations: Tensor) -> Tensor:
    """(S, N, N) -> the same, and 0 where the policy's graph has no edge."""
    adjacency = policy.adjacency(observations)
    return mask if adjacency is None else mask * adjacency


def returned_by(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> object:
    """As `run_explainer`, but the explainer's return value, unchecked; a mask if it was node importances."""
    if explainer.fit is not None and explainer.fitted_on is None:
        raise InputError(f"explainer {explainer.name!r} is not fitted: fit it with `fit_explainer` first.")
    n_steps, n_agents, _ = observations.shape
    name, nodes, explain = explainer.name, explainer.node_importance, explain_of(explainer)
    with _guarded(explainer, seed, f"observations of shape {tuple(observations.shape)}") as generator:
        if explainer.batched:
            returned = explain(*_given(explainer, policy, observations), generator)
            masks = as_edge_masks(name, returned, (n_steps, n_agents, n_agents), nodes)
            return masks.cpu() if isinstance(masks, Tensor) and explainer.device != CPU else masks
        each_mask: list[Tensor] = []
        for x, each in zip(observations, timestep_seeds(n_steps, generator), strict=True):
            drawn = torch.Generator().manual_seed(each)
            returned = explain(*_given(explainer, policy, x), drawn)
            mask = as_edge_masks(name, returned, (n_agents, n_agents), nodes)
            each_mask.append(as_floats(name, mask, (n_agents, n_agents)))
        return torch.stack(each_mask).cpu()


def fit_explainer(explainer: Explainer, policy: Policy, observations: Tensor, seed: int) -> Explainer:
    """The explainer fitted to `policy` on observations (S, N, D); unchanged if it needs no fitting.

    Runs on copies, as `run_explainer` does. Raises InputError, naming the explainer, if it fails.
    """
    if explainer.fit is None:
        return explainer
    elsewhere = elsewhere_of(explainer, policy)
    if elsewhere is not None:
        return replace(explainer, elsewhere=elsewhere.fit(policy, observations, seed), fitted_on=observations)
    with _guarded(explainer, seed, f"{len(observations)} timesteps to be fitted on") as generator:
        fitted = explainer.fit(*_given(explainer, policy, observations), generator)
    return replace(explainer, explain=fitted, fitted_on=observations)


def fitted(explainer: Explainer, policy: Policy, states: Callable[[], Tensor], seed: int) -> Explainer:
    """As `fit_explainer`, for a run with this seed.

    states: gives the policy's `fit_states`, which take seconds to play; not called if nothing is fitted.
    """
    if explainer.fit is None:
        return explainer
    with one_thread():
        return fit_explainer(explainer, policy, states(), derived_seed("fit", seed, explainer.name))


def elsewhere_of(explainer: Explainer, policy: Policy) -> Elsewhere | None:
    """What asks the explainer if it, or the network that it needs, is in another process; None: it runs here.

    Controls need answers of the policy only.
    """
    if explainer.elsewhere is not None or explainer.control or not isinstance(policy, PolicyElsewhere):
        return explainer.elsewhere
    asked: Elsewhere = policy.taking(explainer)
    return asked


def on_device(explainer: Explainer, name: str) -> Explainer:
    """The explainer computing on this device, if it can; else unchanged, on the CPU.

    Raises InputError if the device is unknown or missing.
    """
    device = checked_device(name)
    if not explainer.any_device:
        return explainer
    elsewhere = None if explainer.elsewhere is None else explainer.elsewhere.on_device(device)
    return replace(explainer, device=device, elsewhere=elsewhere)


def _given(explainer: Explainer, policy: Policy, observations: Tensor) -> tuple[Policy, Tensor]:
    """Private copies of policy and observations, on the explainer's device."""
    private, x = copy.deepcopy(policy), observations.clone()
    if explainer.device != CPU:
        private, x = private.to(explainer.device), x.to(explainer.device)
    return seen(explainer, private), x


def explain_of(explainer: Explainer) -> Explain:
    """What is called, with the simulator at hand if the explainer simulates.

    Raises InputError if it does and has none.
    """
    explain: Callable[..., Tensor] = explainer.explain
    if not explainer.simulates:
        return explain
    if explainer.simulator is None:
        raise InputError(
            f"explainer {explainer.name!r} plays on in the world of an episode, and these states have none: "
            f"leave it out."
        )
    return lambda *given: explain(*given, explainer.simulator)


def seen(explainer: Explainer, policy: Policy) -> Policy:
    """The policy as the explainer may access it: the network itself, or a BlackBox."""
    if explainer.accesses in ("black-box", "attention"):
        return BlackBox(policy, attention=explainer.accesses == "attention")
    return policy


def mask_of_explainer(explainer: Explainer, mask: object, n_steps: int, n_agents: int) -> Tensor:
    """The explainer's return value as a checked mask (S, N, N), normalised if it is signed."""
    name = explainer.name
    if explainer.signed:
        mask = signed_to_unit(finite(name, as_floats(name, mask, (n_steps, n_agents, n_agents))))
    checked = checked_mask(name, mask, n_steps, n_agents)
    if explainer.binary and bool(((checked != 0) & (checked != 1)).any()):
        raise InputError(
            f"explainer {name!r} declares binary masks but returned values other than 0 and 1: round them, "
            f"or leave `binary` out."
        )
    return checked


@contextmanager
def _guarded(explainer: Explainer, seed: int, what: str) -> Iterator[torch.Generator]:
    """Seeds global random states, and restores them afterwards. Errors name the explainer."""
    failures = failures_named(f"explainer {explainer.name!r} failed on {what}", "correct it, or leave it out")
    with seeded(seed), class_settings_kept(), torch.inference_mode(False), torch.enable_grad(), failures:
        yield torch.Generator().manual_seed(seed)
