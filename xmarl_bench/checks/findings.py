"""Runs checks: a check is a name and a function of its subject, which returns or raises the reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from xmarl_bench.errors import InputError

Subject = TypeVar("Subject")


class Failed(Exception):  # noqa: N818 - a finding, not an error of ours
    """Raised by a check that fails: what was wrong, what was received, what to do, in one sentence."""


class NotApplicable(Exception):  # noqa: N818
    """Raised by a check that does not apply to this subject, with the reason in one sentence."""


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    check: str
    passed: bool | None  # None: does not apply
    message: str  # why it failed or does not apply; else what was measured, may be empty

    def record(self) -> dict[str, str | bool | None]:
        return {"check": self.check, "passed": self.passed, "said": self.message}


def run_checks(checks: Mapping[str, Callable[[Subject], str]], subject: Subject) -> Iterator[Finding]:
    """Run every check in turn, and yield each finding at once. A failure does not stop the others.

    A check returns what it measured (may be ""), or raises `Failed` or `NotApplicable`. Any other exception
    is a failure too.
    """
    for name, check in checks.items():
        try:
            yield Finding(name, True, check(subject))
        except NotApplicable as reason:
            yield Finding(name, None, str(reason))
        except (Failed, InputError) as failure:
            yield Finding(name, False, str(failure))
        except Exception as error:
            yield Finding(name, False, f"stopped with {type(error).__name__}: {error}".rstrip(". \n") + ".")
