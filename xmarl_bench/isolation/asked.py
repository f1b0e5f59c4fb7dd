"""Asks processes of others: explainers for masks, and policies that are code for F(m).

S is the number of timesteps, N agents, D observation entries, A action entries, H entries of memory. B is the
number of teams.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.isolation.conversation import Conversation, Source, conversation, forgotten
from xmarl_bench.isolation.tensors import Sent
from xmarl_bench.origin.pickling import dumps
from xmarl_bench.policy import ActionDistribution, CodeArchitecture, Policy
from xmarl_bench.policy.device import CPU
from xmarl_bench.policy.elsewhere import PolicyElsewhere
from xmarl_bench.policy.interface import NoAttentionError

POLICIES_KEPT = 4  # in each process
FITS_KEPT = 8


@dataclass(frozen=True)
class Asked:
    """Asks the process of a source: see `xmarl_bench.explain.explainer.Elsewhere`.

    An explainer of others loads in its own process. One that is shipped is sent to that of a policy's code,
    and one of others meets a policy's code in a process for the two of them.
    """

    source: Source
    key: str
    device: str = CPU  # where the explainer computes
    shipped: bytes | None = None  # pickled; None: the process has loaded its explainer
    fit_on: tuple[Policy, NDArray[np.float32], int] | None = None  # policy, (S, N, D) states, seed

    def explain(self, policy: Policy, observations: Tensor, seed: int, simulator: Simulator | None) -> Tensor:
        """(S, N, D) -> (S, N, N), unchecked."""
        fitted = None if self.fit_on is None else self._fitted(*self.fit_on)
        n_steps, n_agents, _ = observations.shape
        header, payload = self._ask(
            "explain",
            policy,
            observations=observations.numpy(),
            seed=seed,
            simulator=simulator,
            fitted=fitted,
        )
        shape = header.get("shape")
        if shape != [n_steps, n_agents, n_agents] or len(payload) != 4 * n_steps * n_agents**2:
            raise InputError(f"{self.source.name} did not return a mask (S, N, N): correct it.")
        return torch.tensor(np.frombuffer(payload, dtype="<f4").reshape(shape))

    def on_device(self, device: str) -> Asked:
        return replace(self, device=device)

    def fit(self, policy: Policy, observations: Tensor, seed: int) -> Asked:
        """(S, N, D) states -> what asks the fitted explainer. Other processes fit it again."""
        fit_on = policy, observations.numpy(), seed
        self._fitted(*fit_on)
        return replace(self, fit_on=fit_on)

    def _fitted(self, policy: Policy, observations: NDArray[np.float32], seed: int) -> str:
        """Fit the explainer, unless the process has done it; returns the key of the fitted one."""
        fits = self._process(policy).fits
        parts = (key_of(policy).encode(), self.key.encode(), observations.tobytes(), str(seed).encode())
        key = hashlib.sha256(b" ".join(parts)).hexdigest()
        if key in fits:
            fits.move_to_end(key)
            return key
        forget = forgotten(fits, FITS_KEPT)
        self._ask("fit", policy, observations=observations, seed=seed, fitted=key, fits=forget)
        fits[key] = None
        return key

    def _ask(self, what: str, policy: Policy, **question: Any) -> tuple[dict[str, Any], bytes]:
        process = self._process(policy)
        sent = sent_policy(process, policy)
        return process.ask({"what": what, "shipped": self.shipped, "device": self.device, **sent, **question})

    def _process(self, policy: Policy) -> Conversation:
        code = policy.source if isinstance(policy, AskedPolicy) else self.source
        return conversation(self.source if code.token == self.source.token else self.source.beside(code))


class AskedPolicy(PolicyElsewhere):
    """Asks the process that holds the policy's code, a batch of teams in one question.

    Gradients with respect to a mask go through the pipe as well.
    """

    def __init__(
        self,
        source: Source,
        pickled: bytes,
        architecture: CodeArchitecture,
        *,
        key: str,
        row_wise: bool,
        memory_dim: int,
        no_attention: str | None,
    ) -> None:
        """pickled: the policy, made in its process; it is loaded in such processes only."""
        super().__init__()
        self.source, self.pickled, self.architecture, self.key = source, pickled, architecture, key
        self.graph, self.memory_dim = architecture.graph, memory_dim
        self.continuous_actions = architecture.distribution != "categorical"
        self.seed: int | None = None  # of its shuffled weights
        self.row_wise, self._no_attention = row_wise, no_attention
        self.sha256 = hashlib.sha256(pickled).hexdigest()

    def shuffled(self, seed: int) -> AskedPolicy:
        other = copy.copy(self)
        other.seed = seed
        return other

    def taking(self, explainer: Explainer) -> Asked:
        pickled = dumps(replace(explainer, simulator=None, fitted_on=None))
        return Asked(self.source, hashlib.sha256(pickled).hexdigest(), explainer.device, pickled)

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """Raises InputError: its network passes messages where its code is."""
        raise InputError(f"{self.source.name} runs in a process of its own: ask it by masks of teams.")

    def prepare(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> the same."""
        return observation

    def decode(self, prepared: Tensor, mask: Tensor | None = None) -> ActionDistribution:
        """F(m), also differentiable with respect to the mask."""
        if mask is not None and mask.requires_grad and torch.is_grad_enabled():
            loc, scale = _Differentiable.apply(mask, self, prepared)  # type: ignore[no-untyped-call]
        else:
            loc, scale = self.answers("decode", prepared, mask)
        return ActionDistribution(loc, scale, self.architecture.distribution)

    def step(self, observation: Tensor, mask: Tensor | None = None) -> tuple[ActionDistribution, Tensor]:
        """(S, N, D) -> F(m), (S, N, H)."""
        loc, scale, memory = self.answers("step", observation, mask, with_memory=True)
        return ActionDistribution(loc, scale, self.architecture.distribution), memory

    def answers(
        self, what: str, observation: Tensor, mask: Tensor | None, *, with_memory: bool = False
    ) -> list[Tensor]:
        """The process's tensors of shape (..., S, N, A) and, with memory, (..., S, N, H)."""
        leading = observation.shape[:-2]
        if mask is not None:
            leading = torch.broadcast_shapes(mask.shape[:-2], leading)
        agents, a = (*leading, observation.shape[-2]), self.architecture.action_dim
        shapes = [(*agents, a), (*agents, a), *[(*agents, self.memory_dim)] * with_memory]
        return self.ask(what, shapes, observation, mask)

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N). Raises NoAttentionError if no layer has attention."""
        if self._no_attention is not None:
            raise NoAttentionError(self._no_attention)
        shape = (*observation.shape[:2], observation.shape[1])
        return self.ask("attention", [shape], observation)[0]

    def why_no_attention(self, observation: Tensor) -> str | None:
        return self._no_attention

    def initial_state(self, n_agents: int) -> Tensor:
        """(N, H), as the network declares it."""
        return self.ask("initial_state", [(n_agents, self.memory_dim)], n_agents=n_agents)[0]

    def step_teams(self, observation: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
        """(B, N, D + H) -> what B teams choose, (B, N, A) or numbers (B, N), and (B, N, H)."""
        teams, n_actions = tuple(observation.shape[:2]), self.architecture.action_dim
        chosen = (*teams, n_actions) if self.continuous_actions else teams
        choice, memory = self.ask("choose", [chosen, (*teams, self.memory_dim)], observation, mask)
        if not bool(torch.isfinite(choice).all()):  # engines of physics end their process at NaN
            raise InputError(f"{self.source.name} chose actions that are NaN or infinite: correct it.")
        if self.continuous_actions:
            return choice, memory
        numbers = choice.long()
        if bool(((numbers < 0) | (numbers >= n_actions)).any()):
            raise InputError(f"{self.source.name} chose an action that its task does not have: correct it.")
        return numbers, memory

    def ask(
        self, what: str, shapes: Sequence[tuple[int, ...]], *tensors: Tensor | None, **more: object
    ) -> list[Tensor]:
        """The process's answer to tensors, of the expected shapes. Raises InputError if it is not that."""
        process = conversation(self.source)
        given = [None if each is None else Sent.of(each) for each in tensors]
        header, payload = process.ask({"what": what, **sent_policy(process, self), "given": given, **more})
        layouts, found, first = header.get("layouts"), list[Tensor](), 0
        try:
            if not isinstance(layouts, list) or len(layouts) != len(shapes):
                raise ValueError("another number of tensors")
            for layout, shape in zip(layouts, shapes, strict=True):
                sent = Sent.parse(layout, shape, payload[first:])
                found.append(sent.tensor())
                first += len(sent.data)
        except ValueError as error:
            raise InputError(f"{self.source.name} returned {error}: correct it.") from None
        return found


class _Differentiable(torch.autograd.Function):
    """F(m) with its gradient with respect to m, both of another process."""

    @staticmethod
    def forward(ctx: Any, mask: Tensor, policy: AskedPolicy, observation: Tensor) -> tuple[Tensor, ...]:
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(mask)
        ctx.policy, ctx.observation = policy, observation
        return tuple(policy.answers("decode", observation, mask))

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        (mask,) = ctx.saved_tensors
        (found,) = ctx.policy.ask("gradient", [tuple(mask.shape)], ctx.observation, mask, *gradients)
        return found, None, None


def key_of(policy: Policy) -> str:
    """The key of a policy in processes of others."""
    if isinstance(policy, AskedPolicy):
        return f"{policy.sha256} {policy.seed}"
    return hashlib.sha256(_pickled(policy)).hexdigest()


def sent_policy(process: Conversation, policy: Policy) -> dict[str, Any]:
    """The key of a policy, and its bytes if the process does not have it."""
    key, known = key_of(policy), process.policies
    if key in known:
        known.move_to_end(key)
        return {"policy": key}
    forget = forgotten(known, POLICIES_KEPT)
    known[key] = None
    seed = policy.seed if isinstance(policy, AskedPolicy) else None
    return {"policy": key, "weights": _pickled(policy), "shuffled": seed, "policies": forget}


def _pickled(policy: Policy) -> bytes:
    return policy.pickled if isinstance(policy, AskedPolicy) else dumps(policy)
