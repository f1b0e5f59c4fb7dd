"""Policies that are code, opened in a process of their own and never here."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from torch import nn

from xmarl_bench.errors import InputError
from xmarl_bench.isolation.asked import AskedPolicy
from xmarl_bench.isolation.conversation import Isolation, Source, conversation, reading_answer, sendable
from xmarl_bench.isolation.tasks import ask_pickled, ask_task
from xmarl_bench.origin.references import Origin, origin_of
from xmarl_bench.policy import CodeArchitecture, Policy, PolicyCard
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.policy.tensors import check_tensors
from xmarl_bench.records.field_types import Text
from xmarl_bench.tasks.sources import task_names

MAX_MEMORY = 2**16  # H, numbers that an agent remembers


class Opened(BaseModel):
    """What a process tells of the policy that it opened."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    card: PolicyCard
    key: Text | None
    row_wise: bool
    memory_dim: Annotated[int, Field(ge=0, le=MAX_MEMORY)]
    no_attention: Text | None
    task_bytes: Annotated[int, Field(ge=0)]  # of the task that it brings, after the policy


def is_code_here(policy: Policy, card: PolicyCard) -> bool:
    """Whether a policy's own code runs in this process."""
    return isinstance(card.architecture, CodeArchitecture) and not isinstance(policy, AskedPolicy)


def isolate_policy(
    policy: PolicyModule | tuple[Policy, PolicyCard], isolation: Isolation
) -> tuple[AskedPolicy, PolicyCard]:
    """A policy made in Python: it is sent to its process by value. Raises InputError if it cannot be."""
    if isinstance(policy, PolicyModule):
        name, network, origin = policy.name, policy.network, origin_of(policy.network)
    else:
        name, network, origin = policy[1].name, policy[0], None
    if isinstance(network, nn.Module):  # else its process says what it is
        check_tensors(network, name)
    pickled = sendable(f"policy {name!r}", policy)
    if isinstance(policy, PolicyModule):
        # Whoever runs the policy's code runs that of its task.
        ask_task(policy.task, isolation, trust_code=True)
    source = Source(f"policy {name}", None, isolation)
    return open_elsewhere(source, {"pickled": pickled, "origin": origin}, origin)


def open_elsewhere(
    source: Source, question: dict[str, Any], origin: Origin | None
) -> tuple[AskedPolicy, PolicyCard]:
    """Open a policy in the process of `source`, with its card.

    origin: where it comes from, if that is known without asking; an entry point "" is asked for. Raises
    InputError if it does not open.
    """
    header, pickled = conversation(source).ask({"what": "open", **question})
    with reading_answer(source):
        header["card"] = PolicyCard.model_validate_json(str(header.get("card")))
        opened = Opened.model_validate(header)
    card, architecture = opened.card, opened.card.architecture
    policy_bytes = len(pickled) - opened.task_bytes
    if opened.task_bytes and card.task not in task_names():
        brought = ask_pickled(pickled[policy_bytes:], card.task, source.isolation, None)
        if brought.name != card.task:
            raise InputError(f"{source.name} brings another task than that of its card: correct it.")
    if not isinstance(architecture, CodeArchitecture):
        raise InputError(f"{source.name} says that it is not code: correct it.")
    if origin is not None:
        known = {
            "package": origin.distribution,
            "version": origin.version,
            "code_sha256": origin.code_sha256,
            "entry_point": origin.entry_point or architecture.entry_point,
        }
        architecture = architecture.model_copy(update=known)
        card = card.model_copy(update={"architecture": architecture})
    policy = AskedPolicy(
        source,
        pickled[:policy_bytes],
        architecture,
        key=opened.key or secrets.token_hex(),
        row_wise=opened.row_wise,
        memory_dim=opened.memory_dim,
        no_attention=opened.no_attention,
    )
    return policy, card
