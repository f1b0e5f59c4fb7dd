"""Which policies come from the same training: their runs share a start, so they are not independent.

A run with the attention-entropy term is, until the term sets in, the run of the same seed without it, and
checkpoints are parts of one run. Statements over policies take such runs as one cluster.
"""

from __future__ import annotations

import hashlib

from xmarl_bench.entry.schema import PolicyRecord
from xmarl_bench.records.files import canonical_json


def training_of(policy: PolicyRecord) -> str:
    """The same for policies of one task, team size, architecture and training seed.

    Without a seed, each policy is its own training.
    """
    own = [policy.task, policy.n_agents, policy.architecture.model_dump(mode="json"), policy.training_seed]
    if policy.training_seed is None:
        own += [policy.name, policy.weights_sha256]
    return hashlib.sha256(canonical_json(own)).hexdigest()[:8]
