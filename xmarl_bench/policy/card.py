"""The card of a policy: what it is and what rebuilds it. Reading one imports no torch and runs no code."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import (
    AnyArchitecture,
    Architecture,
    CodeArchitecture,
    LayeredArchitecture,
)
from xmarl_bench.policy.untrusted import CARD, MAX_BYTES, read_member
from xmarl_bench.records.field_types import Agents, Name, Sha256
from xmarl_bench.records.strict_json import first_error, parse_json, shown

Record = TypeVar("Record")


class PolicyCard(BaseModel):
    """Describes a policy, and holds what is needed to rebuild it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Name
    task: str
    n_agents: Agents
    attention_entropy: float = Field(description="weight lambda of the attention-entropy term in training")
    family: Name | None = Field(
        default=None, description="the networks and recipe it belongs to, e.g. `residual`"
    )
    training_seed: int | None = None
    initial_seed: int | None = Field(
        default=None, description="torch's seed before its initial weights were drawn"
    )
    architecture: AnyArchitecture
    weights_sha256: Sha256
    training: dict[str, Any] = Field(default_factory=dict, description="how it was trained, as recorded then")
    performance: dict[str, Any] = Field(default_factory=dict, description="task metrics, as measured then")


_CARD = TypeAdapter(PolicyCard)


def load_card(bundle: Path) -> PolicyCard:
    """Read and validate `policy.json` only. Raises InputError if it is invalid."""
    return parse_card(read_member(bundle, CARD), str(bundle / CARD))


def parse_card(data: bytes, where: str) -> PolicyCard:
    """The card of a bundle. Raises InputError if it is invalid. where: its path, for the message."""
    card = parse_record(_CARD, "a policy card", data, where)
    if isinstance(card.architecture, CodeArchitecture):
        raise InputError(
            f"{where} is not a policy card: its architecture is code, which bundles do not hold: give "
            f"the code itself, as module:factory with --trust-code."
        )
    return card


def parse_record(kind: TypeAdapter[Record], what: str, data: bytes, where: str) -> Record:
    """A record of strict JSON, of at most a megabyte. Raises InputError if it is not `what`."""
    try:
        parse_json(data, max_bytes=MAX_BYTES[CARD])
        return kind.validate_json(data)
    except ValidationError as error:
        problem, place = first_error(error)
        problem, place = shown(problem, 200).strip("'\""), shown(place or "the whole file")
        raise InputError(f"{where} is not {what}: {problem} at {place}.") from None
    except ValueError as error:
        raise InputError(f"{where} is not {what}: it {error}.") from None


def closed(architecture: AnyArchitecture) -> Architecture | LayeredArchitecture:
    """A card's architecture, which is in the closed list: `parse_card` accepts no other."""
    assert not isinstance(architecture, CodeArchitecture)
    return architecture
