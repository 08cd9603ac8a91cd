"""Confines the calling process before it parses untrusted bytes. Linux only; no heavy imports.

Three independent layers: resource limits (setrlimit(2)); an empty network namespace (network_namespaces(7)) with a
system call filter (seccomp(2)); and file access to lent and Python's own folders only (landlock(7)). Containers and
hardened kernels forbid some of it, see `missing_protections`. Uses ctypes, as no maintained package offers these calls.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import resource
import struct
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_CLONE_NEWIPC, _CLONE_NEWUSER, _CLONE_NEWNET = 0x08000000, 0x10000000, 0x40000000
_PR_SET_NO_NEW_PRIVS, _PR_SET_SECCOMP, _SECCOMP_MODE_FILTER = 38, 22, 2

_LANDLOCK_CREATE, _LANDLOCK_ADD, _LANDLOCK_RESTRICT = 444, 445, 446  # the same numbers on every architecture
_LANDLOCK_VERSION, _LANDLOCK_PATH_BENEATH = 1, 1
_EXECUTE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 2, 1 << 3
_WRITE_FILE, _TRUNCATE, _IOCTL_DEV = 1 << 1, 1 << 14, 1 << 15
_RIGHTS_BY_VERSION = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}  # how many rights each version knows, see landlock(7)
_OF_FILES = _EXECUTE | _READ_FILE | _WRITE_FILE | _TRUNCATE | _IOCTL_DEV
_LEND_READING = _EXECUTE | _READ_FILE | _READ_DIR
_SYSTEM = (
    *("/usr", "/lib", "/lib64", "/bin", "/etc/ld.so.cache", "/etc/localtime", "/proc", "/sys/devices/system"),
    *("/sys/fs/cgroup", "/dev/urandom", "/dev/zero"),
)

_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_LOAD, _EQUAL, _RETURN = 0x20, 0x15, 0x06  # BPF: load a word, jump if equal, return
_NUMBER_AT, _ARCHITECTURE_AT, _FIRST_ARGUMENT_AT = 0, 4, 16  # in struct seccomp_data
_AF_UNIX = 1
_AUDIT_ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
_REFUSED_CALLS = {
    # socket is refused unless it is AF_UNIX; these are always refused:
    # ptrace, process_vm_readv, process_vm_writev, keyctl, add_key, request_key, bpf, perf_event_open, userfaultfd,
    # io_uring_setup (its operations would bypass this filter), mount, pidfd_getfd, kexec_load
    "x86_64": (101, 310, 311, 250, 248, 249, 321, 298, 323, 425, 165, 438, 246),
    "aarch64": (117, 270, 271, 219, 217, 218, 280, 241, 282, 425, 40, 438, 104),
}
_SOCKET_CALL = {"x86_64": 41, "aarch64": 198}
_X32 = 0x40000000  # x86_64's second set of numbers, which no program here uses


@dataclass(frozen=True)
class ResourceLimits:
    """Resource limits of a process."""

    memory_bytes: int  # address space
    cpu_seconds: int  # of all threads together; beyond, the kernel sends SIGXCPU
    file_bytes: int  # size of any written file
    processes: int = 1024  # threads and processes beyond the user's current ones; does not bind root
    open_files: int = 1024


def confine(limits: ResourceLimits, readable: Iterable[Path], writable: Iterable[Path]) -> tuple[str, ...]:
    """Confines this process and its children permanently, before it has threads.

    Args:
        limits: hard limits from now on; lower existing ones stay.
        readable, writable: existing files and folders to read, and folders to change.

    Returns:
        Descriptions of the protections that this kernel or container does not allow.
    """
    _limit(limits)
    attempts = (
        ("a network namespace of its own", _leave_network),
        ("Landlock (files)", lambda: _restrict_files(readable, writable)),
        ("seccomp (system calls)", _filter_calls),
    )
    return tuple(f"{name}: {problem}" for name, attempt in attempts if (problem := _problem(attempt)))


@cache
def missing_protections() -> tuple[str, ...]:
    """Tries `confine` in a subprocess, since a fork may have a server's threads."""
    code = (
        f"from {__name__} import ResourceLimits, confine\n"
        "print('\\n'.join(confine(ResourceLimits(1 << 40, 60, 1 << 30), (), ())))"
    )
    tried = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=60)
    if tried.returncode:
        return (f"confinement: {tried.stderr.strip().rpartition(chr(10))[2]}",)
    return tuple(tried.stdout.split("\n")[:-1]) if tried.stdout.strip() else ()


def _problem(attempt: Callable[[], None]) -> str:
    try:
        attempt()
    except OSError as error:
        return error.strerror or type(error).__name__
    return ""


def _limit(limits: ResourceLimits) -> None:
    amounts = {
        resource.RLIMIT_AS: limits.memory_bytes,
        resource.RLIMIT_CPU: limits.cpu_seconds,
        resource.RLIMIT_FSIZE: limits.file_bytes,
        resource.RLIMIT_NPROC: _tasks_of_user() + limits.processes,
        resource.RLIMIT_NOFILE: limits.open_files,
        resource.RLIMIT_CORE: 0,
    }
    for kind, amount in amounts.items():
        soft, hard = resource.getrlimit(kind)
        bounds = [bound for bound in (soft, hard) if bound != resource.RLIM_INFINITY]
        amount = min([amount, *bounds])
        # SIGXCPU comes at the soft limit and names the reason; the hard one kills what ignores it.
        grace = 5 if kind == resource.RLIMIT_CPU else 0
        resource.setrlimit(kind, (amount, min([amount + grace, *bounds[1:]])))


def _tasks_of_user() -> int:
    """Counts this user's visible threads."""
    user, tasks = os.getuid(), 0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if folder.stat().st_uid == user:
                tasks += len(os.listdir(folder / "task"))
        except OSError:  # it has ended
            continue
    return tasks


def _leave_network() -> None:
    user, group = os.getuid(), os.getgid()
    _call("unshare", _CLONE_NEWUSER | _CLONE_NEWNET | _CLONE_NEWIPC)
    # Otherwise every file would seem to belong to nobody.
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
    Path("/proc/self/gid_map").write_text(f"{group} {group} 1")


def _restrict_files(readable: Iterable[Path], writable: Iterable[Path]) -> None:
    version = _system_call(_LANDLOCK_CREATE, None, 0, _LANDLOCK_VERSION)
    handled = (1 << _RIGHTS_BY_VERSION.get(version, 16)) - 1
    attributes = struct.pack("=Q", handled)
    rules = _system_call(_LANDLOCK_CREATE, attributes, len(attributes), 0)
    try:
        reading, writing = handled & _LEND_READING, handled & ~(_EXECUTE | _IOCTL_DEV)
        for path in (*map(Path, _SYSTEM), *_python_folders(), *readable):
            _lend(rules, path, reading)
        for path in (Path("/dev/null"), *writable):
            _lend(rules, path, writing)
        _forbid_new_privileges()
        _system_call(_LANDLOCK_RESTRICT, rules, 0)
    finally:
        os.close(rules)


def _lend(rules: int, path: Path, rights: int) -> None:
    try:
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        rights = rights if path.is_dir() else rights & _OF_FILES
        rule = struct.pack("=Qi", rights, handle)
        _system_call(_LANDLOCK_ADD, rules, _LANDLOCK_PATH_BENEATH, rule, 0)
    finally:
        os.close(handle)


def _python_folders() -> Sequence[Path]:
    """Folders of the interpreter, installed packages and this product's code, without their surroundings."""
    import fastsplat.service
    import fastsplat_contract

    packages = [Path(entry) for module in (fastsplat, fastsplat_contract) for entry in module.__path__]
    links = [link for package in packages if package.is_dir() for link in package.iterdir() if link.is_symlink()]
    # The import system lists the folder around a package; in a checkout, that is the client's.
    packages += [Path(entry).parent for entry in fastsplat_contract.__path__]
    installed = [Path(entry) for entry in sys.path if "site-packages" in entry or "dist-packages" in entry]
    prefixes = [Path(sys.prefix), Path(sys.base_prefix)]
    return [path.resolve() for path in (*prefixes, *installed, *packages, *links)]


def _filter_calls() -> None:
    machine = platform.machine()
    if machine not in _AUDIT_ARCHITECTURES:
        raise OSError(errno.ENOSYS, f"no filter for {machine}")
    refuse = _instruction(_RETURN, 0, 0, _ERRNO | errno.EPERM)
    program = [
        _instruction(_LOAD, 0, 0, _ARCHITECTURE_AT),
        _instruction(_EQUAL, 1, 0, _AUDIT_ARCHITECTURES[machine]),
        refuse,
        _instruction(_LOAD, 0, 0, _NUMBER_AT),
    ]
    if machine == "x86_64":  # its second set of numbers would bypass the checks below
        program += [_instruction(0x35, 0, 1, _X32), refuse]  # jump if greater or equal
    for number in _REFUSED_CALLS[machine]:
        program += [_instruction(_EQUAL, 0, 1, number), refuse]
    program += [
        _instruction(_EQUAL, 0, 3, _SOCKET_CALL[machine]),
        _instruction(_LOAD, 0, 0, _FIRST_ARGUMENT_AT),
        _instruction(_EQUAL, 1, 0, _AF_UNIX),
        refuse,
        _instruction(_RETURN, 0, 0, _ALLOW),
    ]
    code = ctypes.create_string_buffer(b"".join(program))
    header = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", len(program), ctypes.addressof(code)))
    _forbid_new_privileges()
    _call("prctl", _PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.addressof(header), 0, 0)


def _instruction(operation: int, if_true: int, if_false: int, value: int) -> bytes:
    return struct.pack("=HBBI", operation, if_true, if_false, value)


def _forbid_new_privileges() -> None:
    _call("prctl", _PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)


def _system_call(number: int, *arguments: int | bytes | None) -> int:
    return _call("syscall", number, *arguments)


def _call(name: str, *arguments: int | bytes | None) -> int:
    """Calls a C library function, with whole words for numbers; raises OSError on -1."""
    function = ctypes.CDLL(None, use_errno=True)[name]
    function.restype = ctypes.c_long
    words = [ctypes.c_long(argument) if isinstance(argument, int) else argument for argument in arguments]
    result = int(function(*words))
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
