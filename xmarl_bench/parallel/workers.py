"""How many processes compute, and where: on this machine, or on a cluster of Ray or Dask."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal, get_args

from xmarl_bench.errors import InputError, whole_number

MOST_PER_CORE = 16  # processes of this machine; more only take memory
BackendName = Literal["loky", "ray", "dask"]


@dataclass(frozen=True)
class Workers:
    """Where units of work run. It changes no result. Raises InputError if the values are invalid."""

    jobs: int | None = None  # processes; None: one on this machine, or every worker of a cluster
    backend: BackendName = "loky"
    address: str | None = None  # of a running Ray or Dask cluster; None: we start one on this machine

    def __post_init__(self) -> None:
        if self.jobs is not None:
            object.__setattr__(self, "jobs", whole_number("jobs", self.jobs))
        if self.jobs is not None and self.jobs < 1:
            raise InputError(
                f"jobs must be at least 1, got {self.jobs}: give the number of processes to use."
            )
        most = MOST_PER_CORE * (os.cpu_count() or 1)
        if self.backend == "loky" and self.jobs is not None and self.jobs > most:
            raise InputError(
                f"jobs must be at most {most} here, {MOST_PER_CORE} for each core, got {self.jobs}: give the "
                f"number of processes to use."
            )
        if self.backend not in get_args(BackendName):
            raise InputError(
                f"unknown backend {self.backend!r}: choose one of {', '.join(get_args(BackendName))}."
            )
        if self.address is not None and self.backend == "loky":
            raise InputError(
                f"address {self.address} has no effect with the backend loky, which runs on this machine: "
                f"choose the backend ray or dask."
            )

    @property
    def in_this_process(self) -> bool:
        """Whether units run in this process: loky with one job."""
        return self.backend == "loky" and self.jobs in (None, 1)


ONE_PROCESS = Workers()
