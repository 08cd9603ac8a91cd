"""Build the Dockerfile's images without a Docker engine: buildah over a Debian made by debootstrap."""

from __future__ import annotations

import configparser
import json
import os
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import urlsplit

ROOT = Path(__file__).resolve().parent.parent
_BASE = "docker.io/library/debian:bookworm-slim"
_DPKG = """\
path-exclude /usr/share/doc/*
path-include /usr/share/doc/*/copyright
path-exclude /usr/share/info/*
path-exclude /usr/share/locale/*
path-exclude /usr/share/man/*
"""
_APT = """\
DPkg::Post-Invoke { "rm -f /var/cache/apt/archives/*.deb /var/cache/apt/*.bin"; };
Dir::Cache::pkgcache "";
Dir::Cache::srcpkgcache "";
"""
_CERTIFICATES = Path("/etc/ssl/build-machine.crt")  # the usual name belongs to a Debian package, which must write it


@dataclass(frozen=True)
class Image:
    """A built image, unpacked.

    Attributes:
        root: its file system.
        environment: what ENV set.
        user: "uid:gid".
        command, health: the argument lists of CMD and HEALTHCHECK; `health` is empty where there is none.
    """

    root: Path
    environment: Mapping[str, str]
    user: str
    command: tuple[str, ...]
    health: tuple[str, ...]


class Builder:
    """An image store of its own in a folder that the caller removes."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._storage = [f"--root={folder}/store", f"--runroot={folder}/run", f"--storage-driver={_driver(folder)}"]

    def make_base(self) -> None:
        """The name that the Dockerfile starts from, as a fresh minimal Debian 12."""
        root = self._folder / "debian"
        mirror = _debian_mirror()
        subprocess.run(["debootstrap", "--variant=minbase", "bookworm", root, *mirror], check=True, stdout=2)
        _slim(root)
        container = self._buildah("from", "scratch")
        self._buildah("add", container, str(root), "/")
        self._buildah("commit", "--rm", container, _BASE)

    def build(self, target: str) -> Image:
        """One target of docker/Dockerfile. Its `pip`, `npm` and TLS see this machine's package settings and network."""
        self._buildah(
            *("bud", "--isolation=chroot", "--format=docker", "--layers", "--pull-never", "--jobs=2"),
            *(f"--volume={source}:{target}:ro" for source, target in _package_settings(self._folder).items()),
            *(
                "--build-arg",
                f"NODE_EXTRA_CA_CERTS={_CERTIFICATES}",
                "--build-arg",
                f"npm_config_registry={_npm_registry()}",
            ),
            *("--file", str(ROOT / "docker/Dockerfile"), "--target", target, "--tag", target, str(ROOT)),
        )
        container = self._buildah("from", "--pull-never", f"localhost/{target}")
        config = json.loads(self._buildah("inspect", "--type=image", f"localhost/{target}"))["Docker"]["config"]
        return Image(
            root=Path(self._buildah("mount", container)),
            environment=dict(entry.split("=", 1) for entry in config["Env"]),
            user=config["User"],
            command=tuple(config["Cmd"]),
            health=tuple((config.get("Healthcheck") or {"Test": ["NONE"]})["Test"][1:]),
        )

    def next_release(self, target: str, image: Image, version: str) -> Image:
        """The built image of `target` again, with nothing changed but the release that its package says it is of."""
        root = Path(self._buildah("mount", self._buildah("from", "--pull-never", f"localhost/{target}")))
        (metadata,) = root.glob("opt/fastsplat/lib/python3*/site-packages/fastsplat-*.dist-info/METADATA")
        metadata.write_text(re.sub(r"(?m)^Version: .*$", f"Version: {version}", metadata.read_text(), count=1))
        return replace(image, root=root)

    def close(self) -> None:
        """Unmount everything."""
        self._buildah("rm", "--all")
        mounted = [line.split()[1] for line in Path("/proc/self/mounts").read_text().splitlines()]
        for path in reversed(mounted):  # a process that has just ended may keep one busy for a moment
            if path.startswith(f"{self._folder}/"):
                subprocess.run(["umount", "--lazy", path], check=False, stderr=subprocess.DEVNULL)

    def _buildah(self, *arguments: str) -> str:
        """Run buildah; its last line on stdout, all of its log on stderr."""
        chatty = arguments[0] == "bud"
        done = subprocess.run(
            ["buildah", *self._storage, *arguments], check=True, stdout=2 if chatty else subprocess.PIPE, text=True
        )
        if chatty:
            return ""
        return done.stdout.strip() if arguments[0] == "inspect" else done.stdout.strip().rpartition("\n")[2]


def _slim(root: Path) -> None:
    """Leave out of a fresh Debian what its image of the name "slim" leaves out, now and with packages to come."""
    (root / "etc/dpkg/dpkg.cfg.d/slim").write_text(_DPKG)
    (root / "etc/apt/apt.conf.d/slim").write_text(_APT)
    for folder in ("usr/share/doc", "usr/share/info", "usr/share/locale", "usr/share/man", "var/cache/apt"):
        for path in (root / folder).rglob("*"):
            if path.name != "copyright" and (path.is_symlink() or path.is_file()):
                path.unlink()
    for path in (root / "var/lib/apt/lists").glob("*_*"):
        path.unlink()


def _driver(folder: Path) -> str:
    """overlay where a mount of one works (a root on overlay refuses), else plain copies, which need more disk."""
    with tempfile.TemporaryDirectory(dir=folder) as trial:
        for name in ("lower", "upper", "work", "merged"):
            Path(trial, name).mkdir()
        options = f"lowerdir={trial}/lower,upperdir={trial}/upper,workdir={trial}/work"
        probe = f"mount -t overlay overlay -o {options} {trial}/merged"
        works = subprocess.run(["unshare", "--mount", "sh", "-c", probe], capture_output=True).returncode == 0
    return "overlay" if works else "vfs"


def _debian_mirror() -> Sequence[str]:
    for source in Path("/etc/apt").glob("**/*.sources"):
        if found := re.search(r"^URIs:\s*(\S+/debian/?)\s*$", source.read_text(), re.MULTILINE):
            return [found[1]]
    return []


def _npm_registry() -> str:
    listed = subprocess.run(["npm", "config", "get", "registry"], check=True, capture_output=True, text=True).stdout
    return listed.strip()


def _package_settings(folder: Path) -> Mapping[Path, Path]:
    """Files and folders that pip and TLS on this machine are set to use, and where they belong in the image."""
    listed = subprocess.run(["pip", "config", "list"], check=True, capture_output=True, text=True).stdout
    settings = configparser.ConfigParser(interpolation=None)
    settings["global"] = {
        re.split(r"[.]", key, maxsplit=1)[-1].strip("."): value.strip("'")
        for key, value in (line.split("=", 1) for line in listed.splitlines())
        if not key.startswith("install.")
    }
    certificates = Path(os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt"))
    settings["global"]["cert"] = str(_CERTIFICATES)
    file = folder / "pip.conf"
    with file.open("w") as out:
        settings.write(out)
    values = listed.replace("=", " ").replace("'", " ").split()
    named = {
        Path(urlsplit(value).path) for value in values if value.startswith("/") or urlsplit(value).scheme == "file"
    }
    # An index lies beside its files, so that the folder above "simple" is what must come along.
    folders = {path.parent if path.name == "simple" else path for path in named if path.is_absolute() and path.is_dir()}
    files = {path for path in named if path.is_file() and path.suffix == ".txt"}  # constraints
    return {file: Path("/etc/pip.conf"), certificates: _CERTIFICATES} | {path: path for path in folders | files}
