"""The frame of all checks: a check is a name and a function of its subject, and it passes or says why not."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from xmarl_bench.errors import InputError

Subject = TypeVar("Subject")


class Failed(Exception):  # noqa: N818 - what was found out, not an error of ours
    """Raised by a check: one sentence on what was wrong, what was received, what to do."""


class NotApplicable(Exception):  # noqa: N818
    """Raised by a check that has nothing to say of this subject: one sentence why."""


@dataclass(frozen=True)
class Finding:
    """What one check found out."""

    check: str
    passed: bool | None  # None: does not apply
    said: str  # the sentence of a failure or of what does not apply; else what was measured, may be empty

    def record(self) -> dict[str, str | bool | None]:
        return {"check": self.check, "passed": self.passed, "said": self.said}


def run_checks(checks: Mapping[str, Callable[[Subject], str]], subject: Subject) -> Iterator[Finding]:
    """Every check in turn, each as soon as it is done; the failure of one stops no other.

    A check returns what it measured ("" for nothing to tell), or raises `Failed` or `NotApplicable`.
    Whatever else the subject raises inside it is a failure too.
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
