"""Closes this process in with Landlock and seccomp, where bubblewrap does not work. Linux only.

Afterwards it and its children read only what they are allowed to, write only to their own temporary folder,
open no network socket, hold no capability, and neither signal nor trace processes outside.
Sources: landlock(7), https://docs.kernel.org/userspace-api/landlock.html; seccomp(2).
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # numbers of system calls, on every architecture
SCOPED = 6  # the first version that scopes signals and abstract sockets
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1, 2, 4, 8
ALL_FILES = 2**16 - 1  # every right to files up to version 6: execute (bit 0) to ioctl on devices (bit 15)
READ = EXECUTE | READ_FILE | READ_DIR
ON_FILES = EXECUTE | WRITE_FILE | READ_FILE  # the rights that a file has
NETWORK, SCOPE = 0b11, 0b11  # bind and connect TCP; abstract sockets and signals
CAPABILITIES = 0x20080522  # version of capset(2)
NO_NEW_PRIVILEGES, SET_SECCOMP, FILTER = 38, 22, 2
SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/sbin", "/etc", "/proc", "/sys", "/opt/nvidia")
DEVICES = ("/dev/null", "/dev/zero", "/dev/urandom", "/dev/random")

# System calls that are refused, by architecture: its audit number and theirs. Sockets, tracing and reading
# of other processes, kernel interfaces with a history of holes.
REFUSED = {
    "x86_64": (
        0xC000003E,
        (41, 42, 49, 101, 165, 248, 249, 250, 272, 298, 308, 310, 311, 321, 323, 425, 438),
    ),
    "aarch64": (
        0xC00000B7,
        (198, 203, 200, 117, 40, 217, 218, 219, 97, 241, 268, 270, 271, 280, 282, 425, 438),
    ),
}  # fmt: skip


@cache
def available() -> bool:
    """Whether this system has Landlock with scopes, and seccomp filters for this processor."""
    if sys.platform != "linux" or platform.machine() not in REFUSED or ctypes.sizeof(ctypes.c_void_p) != 8:
        return False
    return int(_libc().syscall(CREATE_RULESET, None, 0, 1)) >= SCOPED


def close_in(readable: Sequence[Path], writable: Path) -> None:
    """Close this process in; call it while it has one thread. Raises OSError if the system refuses."""
    libc = _libc()
    # The kernel fills what a shorter struct leaves out with zeros.
    attributes = struct.pack("<QQQ", ALL_FILES, NETWORK, SCOPE)
    ruleset = _checked(libc.syscall(CREATE_RULESET, attributes, len(attributes), 0))
    for path in [*map(Path, SYSTEM), *readable]:
        _allow(ruleset, path, READ)
    for path in map(Path, DEVICES):
        _allow(ruleset, path, READ_FILE | WRITE_FILE)
    _allow(ruleset, writable, ALL_FILES)
    _checked(libc.capset(struct.pack("<Ii", CAPABILITIES, 0), bytes(24)))  # root's go round Landlock
    _checked(libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _checked(libc.syscall(RESTRICT_SELF, ruleset, 0))
    os.close(ruleset)
    _refuse_system_calls()


def _allow(ruleset: int, path: Path, rights: int) -> None:
    if not path.exists():
        return
    place = os.open(path, getattr(os, "O_PATH", 0) | getattr(os, "O_CLOEXEC", 0))
    try:
        rule = struct.pack("<Qi", rights if path.is_dir() else rights & ON_FILES, place)
        _checked(_libc().syscall(ADD_RULE, ruleset, 1, rule, 0))
    finally:
        os.close(place)


def _refuse_system_calls() -> None:
    """A filter in the kernel's packet language: the right architecture, then no refused number."""
    architecture, refused = REFUSED[platform.machine()]
    load, equal, at_least, give = 0x20, 0x15, 0x35, 0x06
    kill, allow, refuse = 0x80000000, 0x7FFF0000, 0x00050000 | errno.EPERM
    n = len(refused)
    program = [
        (load, 0, 0, 4),  # the architecture of the call
        (equal, 1, 0, architecture),
        (give, 0, 0, kill),
        (load, 0, 0, 0),  # its number
        (at_least, n + 1, 0, 0x40000000),  # numbers of x32, which would go round the list
        *((equal, n - k, 0, number) for k, number in enumerate(refused)),
        (give, 0, 0, allow),
        (give, 0, 0, refuse),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *line) for line in program))
    header = ctypes.create_string_buffer(struct.pack("@HP", len(program), ctypes.addressof(code)))
    _checked(_libc().prctl(SET_SECCOMP, FILTER, header, 0, 0))


def _checked(returned: int) -> int:
    if returned < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return returned


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
