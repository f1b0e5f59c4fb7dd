"""A policy on disk: `policy.safetensors` (weights) and `policy.json` (its card). Loading executes nothing.

A bundle is a folder with the two files, or a zip of them. It is untrusted: xmarl_bench.policy.untrusted
checks it before anything is built. torch is imported only to save or build a network, not to read a bundle.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import PydanticSerializationError
from safetensors import SafetensorError
from safetensors.numpy import load

from xmarl_bench.errors import InputError
from xmarl_bench.policy.card import PolicyCard, closed, load_card
from xmarl_bench.policy.graph import FixedGraph
from xmarl_bench.policy.shapes import weight_shapes
from xmarl_bench.policy.untrusted import CARD, WEIGHTS, check_weights, read_member
from xmarl_bench.records.files import write_atomically
from xmarl_bench.records.strict_json import fields_named, shown
from xmarl_bench.reproducible import torch_defaults

if TYPE_CHECKING:
    from torch import nn

    from xmarl_bench.policy.build import LayeredPolicy
    from xmarl_bench.policy.network import GraphPolicy

LARGEST_TEAM_TRIED = 8  # agents; networks of a bundle do not depend on their number
Weights = dict[str, NDArray[np.float32]]


def save_policy(folder: str | Path, policy: nn.Module, **card: Any) -> PolicyCard:
    """Write weights and card into `folder`, which is created if missing. Each file is written atomically.

    policy: a network of `build_policy`; also compiled, in DataParallel, on another device or in another
        precision, because weights are written as float32. Raises InputError for other networks.
    """
    record, weights = packed(policy, **card)
    write_bundle(Path(folder), record, weights)
    return record


def packed(policy: nn.Module, **card: Any) -> tuple[PolicyCard, bytes]:
    """The card and the weights that `save_policy` writes. Raises InputError if the card is invalid."""
    from xmarl_bench.policy.build import closed_network

    weights, digest = _saved(policy)
    architecture = closed_network(policy).architecture
    with fields_named("the policy's"):
        return PolicyCard(architecture=architecture, weights_sha256=digest, **card), weights


def with_own_weights(policy: nn.Module, card: PolicyCard) -> PolicyCard:
    """The card with the hash of the policy's weights, which may have changed since they were loaded."""
    return card.model_copy(update={"weights_sha256": _saved(policy)[1]})


def _saved(policy: nn.Module) -> tuple[bytes, str]:
    """The content of a policy's file of weights, and its hash."""
    from safetensors.torch import save

    from xmarl_bench.policy.build import weights_of

    weights = save(weights_of(policy))
    return weights, hashlib.sha256(weights).hexdigest()


def write_bundle(folder: Path, card: PolicyCard, weights: bytes) -> None:
    """Write both files. Raises InputError, before it writes, if the card cannot be written as JSON."""
    try:
        text = card.model_dump_json(indent=2)
    except PydanticSerializationError as error:
        raise InputError(
            f"the card of policy {card.name!r} cannot be written as JSON ({error}): give it plain numbers, "
            f"texts, lists and dicts."
        ) from None
    write_atomically(folder / WEIGHTS, weights)
    write_atomically(folder / CARD, f"{text}\n".encode())


def load_policy(
    bundle: str | Path, card: PolicyCard | None = None
) -> tuple[GraphPolicy | LayeredPolicy, PolicyCard]:
    """Rebuild the network of a bundle, in evaluation mode. card: the bundle's card, if already loaded.

    Raises InputError if a file is missing, truncated or does not fit the card, or if a weight is not finite.
    """
    bundle = Path(bundle)
    if card is None:
        card = load_card(bundle)
    weights = parse_weights(read_member(bundle, WEIGHTS), card, str(bundle / WEIGHTS))
    return build(card, weights), card


@torch_defaults()
def build(card: PolicyCard, weights: Weights) -> GraphPolicy | LayeredPolicy:
    """The network of a card with weights that `parse_weights` returned, in evaluation mode.

    Raises InputError if a mask scales other edges than its own, which would be a bug of ours.
    """
    import torch

    from xmarl_bench.policy.build import build_policy
    from xmarl_bench.policy.interventions import check_interventions, random_teams

    architecture = closed(card.architecture)
    policy = build_policy(architecture, {name: torch.tensor(array) for name, array in weights.items()})
    graph = architecture.graph
    n_agents = graph.n_agents if isinstance(graph, FixedGraph) else min(card.n_agents, LARGEST_TEAM_TRIED)
    check_interventions(policy, random_teams(2, n_agents, architecture.obs_dim))
    return policy


def parse_weights(data: bytes, card: PolicyCard, where: str) -> Weights:
    """The weights that belong to a card, with the names and shapes of `weight_shapes`, all finite.

    Raises InputError for anything else. where: their path, for the message.
    """
    check_weights(data, weight_shapes(closed(card.architecture)), where)
    try:
        weights = load(data)
    except SafetensorError as error:
        raise InputError(f"{where} cannot be read as safetensors ({shown(error)}): save it again.") from None
    if not all(bool(np.isfinite(array).all()) for array in weights.values()):
        raise InputError(f"{where} holds weights that are NaN or infinite: train or save it again.")
    digest = hashlib.sha256(data).hexdigest()
    if digest != card.weights_sha256:
        raise InputError(
            f"{where} has sha256 {digest[:12]}..., but its card says {card.weights_sha256[:12]}...: "
            f"use the two files that were saved together."
        )
    return weights
