"""Checks for degenerate explanations: valid masks that explain nothing.

A mask may rank no message at all, or be the same in every state, for every receiver, or for any policy. The
check "order of timesteps" finds masks of another timestep. Metrics do not find all of these: the mask of the
previous timestep scores nearly as well as the right one.

Whether a mask should differ between states and receivers depends on the policy: the attention of a trained
policy may rank senders alike for every receiver. So these two checks use a planted policy, whose receivers
each listen to another sender, drawn anew in every state.

Masks are compared by rank correlation of the senders of a receiver, without own edges. S is the number of
timesteps, N agents.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.checks.explainer_subject import SEED, ExplainerSubject
from xmarl_bench.checks.findings import Failed, NotApplicable
from xmarl_bench.errors import InputError
from xmarl_bench.explain.sanity import mask_of_shuffled_weights
from xmarl_bench.metrics import other_senders, rank_correlation
from xmarl_bench.policy import existing_edges

SAME: Final = 0.99  # rank correlation above which two masks count as equal
DIGITS: Final = 6  # of mask values: smaller differences are rounding, and would break ties
Floats = NDArray[np.float64]
Edges = NDArray[np.bool_]


def tells_messages_apart(subject: ExplainerSubject) -> str:
    mask = _messages(_mask(subject))
    edges = _edges(subject)
    present = mask if edges is None else np.where(edges, mask, np.nan)
    share = float((present != _first_of(present)).any(axis=-1, where=~np.isnan(present)).mean())
    if share == 0.0:
        raise Failed("all messages of a receiver have the same value, in every state: rank them.")
    return f"messages differ in {share:.0%} of the rows"


def follows_the_policy(subject: ExplainerSubject) -> str:
    mask = _mask(subject)
    shuffled = mask_of_shuffled_weights(subject.explainer, subject.policy, subject.observations, SEED)
    same = rank_correlation(_messages(mask), _messages(shuffled.numpy()), _edges(subject))
    if same > SAME:
        raise Failed(
            f"the mask is the same after the policy's weights are shuffled (rank correlation {same:.3f}): "
            f"explain the given policy."
        )
    return "" if np.isnan(same) else f"rank correlation with the mask of shuffled weights {same:.2f}"


def follows_the_state(subject: ExplainerSubject) -> str:
    return _differs(subject, mean_over_states, "state")


def follows_the_receiver(subject: ExplainerSubject) -> str:
    return _differs(subject, mean_over_receivers, "receiver")


DEGENERATE_CHECKS: Final[dict[str, Callable[[ExplainerSubject], str]]] = {
    "tells messages apart": tells_messages_apart,
    "follows the policy": follows_the_policy,
    "follows the state": follows_the_state,
    "follows the receiver": follows_the_receiver,
}


def mean_over_states(mask: Floats) -> Floats:
    """(S, N, N) -> (S, N, N), the same in every state."""
    return np.broadcast_to(mask.mean(axis=0), mask.shape)


def mean_over_receivers(mask: Floats) -> Floats:
    """(S, N, N) -> (S, N, N), the same for every receiver; the mean excludes own edges."""
    others = ~np.eye(mask.shape[-1], dtype=bool)
    column = (mask * others).sum(axis=1, keepdims=True) / others.sum(axis=0)
    return np.broadcast_to(column, mask.shape)


def sameness(mask: Floats, mean: Callable[[Floats], Floats]) -> float:
    """(S, N, N) -> rank correlation of the mask with its mean: 1 if they are alike, NaN for constant rows."""
    return rank_correlation(_messages(mask), _messages(mean(mask)))


def _differs(subject: ExplainerSubject, mean: Callable[[Floats], Floats], what: str) -> str:
    _mask(subject)
    try:
        mask = subject.planted_mask
    except InputError as error:
        raise NotApplicable(f"it does not explain a planted policy: {error}") from None
    same = sameness(mask.numpy().astype(np.float64), mean)
    if same > SAME:
        raise Failed(
            f"on a planted policy, whose relevant sender differs between {what}s, the mask ranks senders "
            f"alike for every {what} (rank correlation with its mean {same:.3f}): explain each {what}."
        )
    return "" if np.isnan(same) else f"rank correlation with its mean over {what}s {same:.2f}"


def _mask(subject: ExplainerSubject) -> Floats:
    """(S, N, N)"""
    if subject.explainer.control:
        raise NotApplicable("controls are not explanations.")
    mask = subject.mask_or_skip().numpy().astype(np.float64)
    if mask.shape[-1] < 3:
        raise NotApplicable("needs three agents, so that a receiver has two senders to rank.")
    return mask


def _messages(mask: NDArray[np.floating]) -> Floats:
    """(S, N, N) -> (S, N, N - 1)"""
    return np.asarray(np.round(other_senders(mask.astype(np.float64)), DIGITS), dtype=np.float64)


def _first_of(present: Floats) -> Floats:
    """(S, N, M), NaN for absent senders -> (S, N, 1): the value of a row's first sender."""
    first = np.isnan(present).argmin(axis=-1)[..., None]
    return np.take_along_axis(present, first, axis=-1)


def _edges(subject: ExplainerSubject) -> Edges | None:
    edges = existing_edges(subject.policy, subject.observations)
    return None if edges is None else other_senders(edges)
