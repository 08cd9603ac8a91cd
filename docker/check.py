"""Do the images work? Lint, build in a clean Debian, run as a container would, ask a question; and does a job that is
under way go on where the images of a next release take the place of these?

`python docker/check.py` as root on Debian with buildah, debootstrap, docker-compose and npm, from the development
environment, with 20 GB of free disk. Network: the package registries that apt, pip and npm are set to. FASTSPLAT_MODELS
names a model directory; without one the `models` image fetches the defaults.
"""

from __future__ import annotations

import json
import os
import secrets
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

from images import ROOT, Builder, Image

from fastsplat_client import Client, SceneOptions
from tests.postgres import PostgresServer

_PATIENCE_S = 1200.0
_UID = 10001
_NEXT = "0.1.9999"
"""A release that is none, of the minor release that clients of this one fit."""


def main() -> int:
    """Exit status 0 when everything held."""
    subprocess.run(["hadolint", "docker/Dockerfile", "docker/ros2.Dockerfile"], cwd=ROOT, check=True)
    subprocess.run(["docker-compose", "-f", "docker/compose.yaml", "config", "-q"], cwd=ROOT, check=True)
    if (free := shutil.disk_usage(tempfile.gettempdir()).free) < 20e9:  # 16 GB are taken for a while
        sys.exit(f"{tempfile.gettempdir()} has {free / 1e9:.0f} GB free, and building the images needs 20")
    folder = Path(tempfile.mkdtemp(prefix="fastsplat-images-"))
    builder = Builder(folder)
    try:
        builder.make_base()
        images = {target: builder.build(target) for target in ("models", "worker", "api")}
        for target in ("worker", "api"):
            _check_contents(target, images[target])
        newer = {target: builder.next_release(target, images[target], _NEXT) for target in ("worker", "api")}
        _check_service(folder, images, newer)
    finally:
        builder.close()
        shutil.rmtree(folder, ignore_errors=True)
    print("the images build, run and answer")
    return 0


def _check_contents(target: str, image: Image) -> None:
    """No compiler, no package tool of the build, a user that is not root; how large it is."""
    assert image.user == f"{_UID}:{_UID}", f"{target} runs as {image.user!r}"
    assert image.health, f"{target} has no health check"
    for tool in ("gcc", "g++", "cc", "make", "npm"):
        assert not list(image.root.glob(f"usr/bin/{tool}")), f"{target} holds {tool}"
    size = sum(path.lstat().st_size for path in image.root.rglob("*") if path.is_file() and not path.is_symlink())
    print(f"{target}: {size / 1e9:.2f} GB unpacked")


def _check_service(folder: Path, images: Mapping[str, Image], newer: Mapping[str, Image]) -> None:
    """Start the service of `images` and ask it, then have `newer` go on with a job of it."""
    data, models = folder / "data", folder / "models"
    for path in (data, models):
        path.mkdir()
        os.chown(path, _UID, _UID)
    if given := os.environ.get("FASTSPLAT_MODELS"):
        models = Path(given).resolve()
    http, grpc, metrics, postgres = _free_ports(4)
    secret = folder / "database_password"
    secret.write_text(secrets.token_hex(24) + "\n")
    secret.chmod(0o444)
    environment = {
        # As in compose.yaml, whose network calls the server's machine "postgres".
        "FASTSPLAT_DATABASE_URL": f"postgresql://fastsplat@127.0.0.1:{postgres}/fastsplat",
        "FASTSPLAT_DATABASE_PASSWORD_FILE": "/run/secrets/database_password",
        "FASTSPLAT_HTTP_PORT": str(http),
        "FASTSPLAT_GRPC_PORT": str(grpc),
        "FASTSPLAT_METRICS_PORT": str(metrics),
        "FASTSPLAT_HOST": "127.0.0.1",  # a container has a network of its own; here it is this machine's
        "FASTSPLAT_METRICS_HOST": "127.0.0.1",
        # By steps and not by time: a slow machine would look at fewer photos, and miss the banana.
        "FASTSPLAT_TRAINING__ITERATIONS": "400",
        "FASTSPLAT_TRAINING__TIME_BUDGET_S": "600",
    }
    if not given:
        with _running(images["models"], "models", {}, data, models, folder, writable_models=True) as fetch:
            assert fetch.wait(_PATIENCE_S) == 0, "the models could not be fetched"
    url, capture = f"http://127.0.0.1:{http}", _make_capture(folder)
    with closing(PostgresServer(secret.read_text().strip(), postgres)):
        with _service(folder, images, environment, data, models):
            key = (data / "key").read_text().strip()
            with Client(url, key=key) as client:
                _ask(client, capture)
                job = _begin_training(client, capture)
        with _service(folder, newer, environment, data, models), Client(url, key=key) as client:
            assert client.server().version == _NEXT, client.server()
            ended = client.wait(job, timeout_s=_PATIENCE_S)
            assert (ended.state, ended.again_after) == ("SUCCEEDED", "worker_stopped"), ended
            print("a job that was under way went on in the images of the next release")


@contextmanager
def _service(
    folder: Path, images: Mapping[str, Image], environment: Mapping[str, str], data: Path, models: Path
) -> Iterator[None]:
    """API and worker, from when both are healthy."""
    with (
        _running(images["api"], "api", environment, data, models, folder) as api,
        _running(images["worker"], "worker", environment, data, models, folder) as worker,
    ):
        for target, process in (("api", api), ("worker", worker)):
            _until(f"{target} is healthy", partial(_healthy, images[target], environment, data, models))
            assert process.poll() is None, f"{target} has ended"
        yield


def _make_capture(folder: Path) -> Path:
    """A few of the sample's photos, with their poses."""
    sample, capture = ROOT / "demo/sample", folder / "capture"
    (capture / "images").mkdir(parents=True)
    names = sorted(path.name for path in (sample / "images").glob("*.jpg"))[::3]
    for name in names:
        shutil.copy(sample / "images" / name, capture / "images" / name)
    transforms = json.loads((sample / "transforms.json").read_text())
    transforms["frames"] = [
        {name: value for name, value in frame.items() if name != "mask_path"}  # the detector is to run
        for frame in transforms["frames"]
        if Path(frame["file_path"]).name in names
    ]
    del transforms["labels"]
    (capture / "transforms.json").write_text(json.dumps(transforms))
    return capture


def _ask(client: Client, capture: Path) -> None:
    """Post the photos, wait for the scene, see that their poses arrived, ask for the banana."""
    posted = client.create_scene(capture, options=SceneOptions(max_gaussians=5_000))
    operation = client.wait(posted.id, timeout_s=_PATIENCE_S)
    assert operation.state == "SUCCEEDED", operation
    frames = json.loads((capture / "transforms.json").read_text())["frames"]
    poses = {frame["file_path"]: frame["transform_matrix"] for frame in frames}
    for posed in client.scene(operation.scene_id).cameras:
        for row in range(3):
            sent, result = poses[posed.name][row][3], posed.world_from_camera[row, 3]
            assert abs(sent - result) < 1e-6, f"{posed.name} was posted with a pose and has another"
    (answer,) = client.query(operation.scene_id, "banana")
    print(answer.sentence)
    assert answer.outcome == "here", answer
    assert client.export(operation.scene_id, "mcap").startswith(b"\x89MCAP0"), "no file for Foxglove"


def _begin_training(client: Client, capture: Path) -> str:
    """Post the photos once more; the id of the job, whose training has begun."""
    job = client.create_scene(capture, options=SceneOptions(max_gaussians=5_000)).id
    begun = (now for now in client.watch(job) if now.done or "training" in {stage.stage for stage in now.stages})
    operation = next(begun)
    assert not operation.done, operation
    return job


@contextmanager
def _running(
    image: Image,
    name: str,
    environment: Mapping[str, str],
    data: Path,
    models: Path,
    folder: Path,
    *,
    writable_models: bool = False,
) -> Iterator[subprocess.Popen[bytes]]:
    """The image's CMD, stopped in the end as `docker stop` does; what it wrote is shown if anything went wrong."""
    log = folder / f"{name}.log"
    with log.open("ab") as out:
        process = subprocess.Popen(
            _contained(image, environment, data, models, image.command, writable_models), stdout=out, stderr=out
        )
    try:
        yield process
        process.terminate()
        assert process.wait(40) in (0, -15), f"{name} ended with {process.returncode}"
    except BaseException:
        process.kill()
        sys.stderr.write(f"--- {name}\n{log.read_text(errors='replace')[-8000:]}\n")
        raise


def _healthy(image: Image, environment: Mapping[str, str], data: Path, models: Path) -> bool:
    done = subprocess.run(_contained(image, environment, data, models, image.health), capture_output=True)
    return done.returncode == 0


def _contained(
    image: Image,
    environment: Mapping[str, str],
    data: Path,
    models: Path,
    command: tuple[str, ...] | list[str],
    writable_models: bool = False,
) -> list[str]:
    """`command` as the image's user on a root that cannot be written, with /tmp, /data and /models as compose gives
    them. `exec` all the way, so that a signal to the process returned reaches the command itself."""
    root = shlex.quote(str(image.root))
    secret = shlex.quote(str(data.parent / "database_password"))
    settings = {**image.environment, **environment, "HOME": "/home/fastsplat"}
    lines = [
        "set -e",
        f"mount --bind {root} {root}",
        f"mount -o remount,ro,bind {root}",
        f"mount -t proc proc {root}/proc",
        f"mount --rbind /dev {root}/dev",
        f"mount -t tmpfs tmpfs {root}/tmp",
        f"mount -t tmpfs tmpfs {root}/run",
        f"mkdir {root}/run/secrets",
        f"if [ -f {secret} ]; then cp {secret} {root}/run/secrets/database_password; fi",
        f"mount --bind {shlex.quote(str(data))} {root}/data",
        f"mount --bind {shlex.quote(str(models))} {root}/models",
        "" if writable_models else f"mount -o remount,ro,bind {root}/models",
        f"mount -t tmpfs -o uid={_UID},gid={_UID} tmpfs {root}/home/fastsplat" if writable_models else "",
        f"! chroot --userspec={image.user} {root} sh -c 'touch /opt/fastsplat/probe /probe' 2>/dev/null",
        f"exec chroot --userspec={image.user} {root} /usr/bin/env -i "
        + shlex.join([*(f"{key}={value}" for key, value in settings.items()), *command]),
    ]
    return ["unshare", "--mount", "sh", "-c", "\n".join(lines)]


def _until(what: str, holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"waited {_PATIENCE_S:.0f} s until {what}"
        time.sleep(1.0)
    print(what)


def _free_ports(count: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [listener.getsockname()[1] for listener in sockets]
    for listener in sockets:
        listener.close()
    return ports


if __name__ == "__main__":
    sys.exit(main())
