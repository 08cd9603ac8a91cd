"""The Kustomize base and its overlay: Kubernetes' own schemas hold, and what they name is what the product has."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from fastsplat.api.rest.openapi import describe
from fastsplat.service.settings import Settings
from tests.docker.test_compose import COMPOSE, ROOT

_BASE = ROOT / "docker/kubernetes/base"
_CUDA = ROOT / "docker/kubernetes/cuda"
_DOCKERFILE = (ROOT / "docker/Dockerfile").read_text()


def _kustomization(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((folder / "kustomization.yaml").read_text())
    return content


_RESOURCES = [
    item for name in _kustomization(_BASE)["resources"] for item in yaml.safe_load_all((_BASE / name).read_text())
]
_PODS = {
    item["metadata"]["name"]: item["spec"]["template"]["spec"] for item in _RESOURCES if item["kind"] == "Deployment"
}


@pytest.mark.parametrize("release", ["1.30", "1.37"])
def test_every_resource_is_of_the_schemas_of_kubernetes(release: str) -> None:
    for resource in _RESOURCES:
        assert kubernetes_validate.validate(resource, release, strict=True)
    for folder in (_BASE, _CUDA) if shutil.which("kubectl") else ():
        built = subprocess.run(["kubectl", "kustomize", folder], check=True, capture_output=True, text=True).stdout
        for resource in yaml.safe_load_all(built):
            assert kubernetes_validate.validate(resource, release, strict=True)


def test_the_overlay_lies_beside_its_base_as_kustomize_refuses_a_base_that_holds_it() -> None:
    (base,) = _kustomization(_CUDA)["resources"]
    assert (_CUDA / base).resolve() == _BASE and not _CUDA.is_relative_to(_BASE)


@pytest.mark.parametrize("name", _PODS)
def test_a_pod_runs_an_image_of_the_dockerfile_as_its_user_bounded_and_confined(name: str) -> None:
    pod, user = _PODS[name], int(re.findall(r"^USER (\d+):\1$", _DOCKERFILE, re.MULTILINE)[0])
    assert pod["securityContext"].items() >= {"runAsNonRoot": True, "runAsUser": user, "fsGroup": user}.items()
    names = {volume["name"] for volume in pod["volumes"]}
    for container in (*pod["initContainers"], *pod["containers"]):
        assert container["resources"]["requests"].keys() == {"cpu", "memory"} and container["resources"]["limits"]
        confined = {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert container["securityContext"] == confined
        assert {mount["name"] for mount in container["volumeMounts"]} <= names
    (container,) = pod["containers"]
    assert {mount["mountPath"] for mount in container["volumeMounts"]} >= {"/data", "/models", "/tmp"}


def test_the_images_are_those_of_compose_in_this_release() -> None:
    built = {service["image"].split(":")[0] for service in yaml.safe_load(COMPOSE.read_text())["services"].values()}
    tags = {image["name"]: image["newTag"] for image in _kustomization(_BASE)["images"]}
    used = {item["image"] for pod in _PODS.values() for item in (*pod["initContainers"], *pod["containers"])}
    (cuda,) = _kustomization(_CUDA)["images"]
    assert used == tags.keys() and {*used, cuda["newName"]} == {name for name in built if name.startswith("fastsplat/")}
    for name, tag in tags.items():
        assert f"image: {name}:${{IMAGE_VERSION:-{tag}}}" in COMPOSE.read_text()


def test_probes_and_ports_are_those_of_the_server() -> None:
    (api,), (worker,) = _PODS["api"]["containers"], _PODS["worker"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in api["ports"]}
    assert f"EXPOSE {' '.join(map(str, ports.values()))}\n" in _DOCKERFILE
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert "get" in describe()["paths"][api[probe]["httpGet"]["path"]] and api[probe]["httpGet"]["port"] == "http"
    assert f"CMD {worker['readinessProbe']['exec']['command']}".replace("'", '"') in _DOCKERFILE
    assert all(port["targetPort"] in ports for port in _RESOURCES[0]["spec"]["ports"])


@pytest.mark.parametrize("name", _PODS)
def test_a_pod_s_environment_is_settings_with_the_database_s_password_of_the_secret(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (container,) = _PODS[name]["containers"]
    (generated,), (merged,) = (_kustomization(folder)["configMapGenerator"] for folder in (_BASE, _CUDA))
    files = [_BASE / file for file in generated["envs"]]
    lines = [line for file in files for line in file.read_text().splitlines() if not line.startswith("#")]
    environment = dict(line.split("=", 1) for line in (*lines, *merged["literals"]))
    environment |= {entry["name"]: entry["value"] for entry in container["env"]}
    assert {"configMapRef": {"name": generated["name"]}} in container["envFrom"] and merged["name"] == generated["name"]
    mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    (tmp_path / "password").write_text("p@ss\n")
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value.replace(mounts["database"], str(tmp_path)))
    settings = Settings()
    assert "p%40ss@" in settings.database_url and settings.artefacts.url and settings.training.backend == "cuda"
    if name == "worker":
        assert settings.jobs.threads_per_job == int(container["resources"]["requests"]["cpu"])
