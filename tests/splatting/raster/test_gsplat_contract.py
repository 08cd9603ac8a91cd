"""What `cuda.py` asks of gsplat, against the sources of the pinned release: by their syntax, so without a GPU."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from raster_scenes import crowded

from fastsplat.service.splatting.raster import cuda, median_depth
from fastsplat.service.splatting.raster.image_formation import RasterSettings
from tests.splatting import gsplat_front_end

_SPEC = importlib.util.find_spec("gsplat")
assert _SPEC is not None and _SPEC.origin is not None
_GSPLAT = Path(_SPEC.origin).parent
_ADAPTER, _MEDIAN = (ast.parse(Path(module.__file__).read_text()) for module in (cuda, median_depth))


def _function(path: Path, name: str) -> ast.FunctionDef:
    (function,) = [
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and node.name == name
    ]
    return function


@pytest.fixture(scope="module")
def rasterization() -> ast.FunctionDef:
    """gsplat's function."""
    return _function(_GSPLAT / "rendering.py", "rasterization")


@pytest.fixture(scope="module")
def call() -> ast.Call:
    """The one call of it."""
    (found,) = [
        node
        for node in ast.walk(_ADAPTER)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "gsplat.rasterization"
    ]
    return found


def test_the_installed_release_is_the_pinned_one() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["optional-dependencies"]["cuda"] == [f"gsplat=={importlib.metadata.version('gsplat')}"]


def test_arguments_are_where_gsplat_expects_them(rasterization: ast.FunctionDef, call: ast.Call) -> None:
    parameters = [argument.arg for argument in rasterization.args.args]
    starred, *rest = call.args
    assert isinstance(starred, ast.Starred) and isinstance(starred.value, ast.GeneratorExp)
    (loop,) = starred.value.generators
    assert isinstance(loop.iter, ast.Tuple)
    arguments = [node.attr for node in loop.iter.elts if isinstance(node, ast.Attribute)]
    arguments += [ast.unparse(node) for node in rest]
    named = {"colors": "features", "viewmats": "viewmat", "Ks": "_intrinsics"}
    positional = parameters[: len(arguments)]
    assert len(arguments) == 9
    assert [name for name, text in zip(positional, arguments, strict=True) if named.get(name, name) not in text] == []
    assert {keyword.arg for keyword in call.keywords} <= set(parameters[len(arguments) :])


def test_words_are_among_those_that_gsplat_knows(rasterization: ast.FunctionDef, call: ast.Call) -> None:
    annotations = {argument.arg: argument.annotation for argument in rasterization.args.args}
    words = {
        keyword.arg: keyword.value.value
        for keyword in call.keywords
        if isinstance(keyword.value, ast.Constant) and isinstance(keyword.value.value, str)
    }
    assert set(words) == {"render_mode", "rasterize_mode"}
    for name, word in words.items():
        annotation = annotations[str(name)]
        assert annotation is not None and word in [
            node.value for node in ast.walk(annotation) if isinstance(node, ast.Constant)
        ]


def test_what_comes_back_is_what_is_taken_apart(rasterization: ast.FunctionDef) -> None:
    last = rasterization.body[-1]
    assert isinstance(last, ast.Return) and last.value is not None
    assert ast.unparse(last.value) == "(render_colors, render_alphas, meta)"
    (taken,) = [
        node.targets[0]
        for node in ast.walk(_ADAPTER)
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("gsplat.rasterization(")
    ]
    assert ast.unparse(taken) == "(pictures, alphas, meta)"
    used, offered = set(_keys_of_meta(_ADAPTER)) | set(_keys_of_meta(_MEDIAN)), set()
    for node in ast.walk(rasterization):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "meta.update":
            (update,) = node.args
            assert isinstance(update, ast.Dict)
            offered |= {key.value for key in update.keys if isinstance(key, ast.Constant)}
    assert used and used <= offered


def _keys_of_meta(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "meta":
            assert isinstance(node.slice, ast.Constant)
            yield str(node.slice.value)


def test_cut_offs_are_those_that_the_kernels_fix() -> None:
    header = (_GSPLAT / "cuda/include/Common.h").read_text()
    kernel = (_GSPLAT / "cuda/csrc/RasterizeToPixels3DGSFwd.cu").read_text()
    assert "#define ALPHA_THRESHOLD (1.f / 255.f)" in header
    (alpha_max,) = re.findall(r"float alpha = min\((\S+)f, opac", kernel)
    (transmittance_min,) = re.findall(r"if \(next_T <= (\S+)f\)", kernel)
    settings = RasterSettings()
    assert (float(alpha_max), float(transmittance_min)) == (0.999, settings.transmittance_min)
    assert settings.alpha_min == pytest.approx(1 / 255)
    front_end = (gsplat_front_end.ALPHA_MIN, gsplat_front_end.ALPHA_MAX, gsplat_front_end.TRANSMITTANCE_MIN)
    assert front_end == (1 / 255, float(alpha_max), float(transmittance_min))


def test_lists_of_tiles_in_vectors_are_those_of_gsplat() -> None:
    from gsplat.cuda._torch_impl import _isect_tiles

    view = crowded(3)
    generator = torch.Generator().manual_seed(1)
    means = torch.rand(1, 40, 2, generator=generator) * torch.tensor([90.0, 70.0]) - 10
    radii = torch.randint(0, 30, (1, 40, 2), generator=generator, dtype=torch.int32)
    depths = view.splats.means[None, :40, 2].abs() + 0.1
    ours = gsplat_front_end.isect_tiles(means, radii, depths, 16, 5, 4)
    theirs = _isect_tiles(means, radii, depths, 16, 5, 4)
    assert len(theirs[1]) > 40
    assert all(torch.equal(mine, its) for mine, its in zip(ours[:2], theirs[:2], strict=True))
    assert torch.equal(depths[0, ours[2]], depths[0, theirs[2]])
