"""Child process: MobileSAM's checkpoint to ONNX. Usage: convert_mobile_sam.py CARRIERS TARGET PACKAGES.

The model's own code builds the network, with its imports from timm replaced; the checkpoint is read as plain tensors.
"""

from __future__ import annotations

import importlib
import shutil
import sys
import types
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import nn

_OPSET = 17
_SIDE = 1024


class _DropPath(nn.Module):
    """Stochastic depth, which drops nothing at inference."""

    def __init__(self, drop_prob: float = 0.0, scale_by_keep: bool = True) -> None:
        super().__init__()
        self.drop_prob = drop_prob

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x


class _Encoder(nn.Module):
    """RGB 0..255 to features, with the pixel normalization in the graph."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, sam: Any) -> None:
        super().__init__()
        self.image_encoder = sam.image_encoder
        self.register_buffer("mean", sam.pixel_mean.reshape(1, 3, 1, 1))
        self.register_buffer("deviation", sam.pixel_std.reshape(1, 3, 1, 1))

    def forward(self, image: torch.Tensor) -> Any:
        return self.image_encoder((image - self.mean) / self.deviation)


class _BatchDecoder(nn.Module):
    """Decodes many prompts for one image on the mask grid, with a constant absent mask."""

    positions: torch.Tensor

    def __init__(self, sam: Any, wrapper: Any) -> None:
        super().__init__()
        self.wrapper = wrapper(sam, return_single_mask=False)
        self.sam = sam
        self.register_buffer("positions", sam.prompt_encoder.get_dense_pe())

    def forward(self, embeddings: torch.Tensor, points: torch.Tensor, kinds: torch.Tensor) -> tuple[Any, Any]:
        decoder = self.sam.mask_decoder
        sparse = self.wrapper._embed_points(points, kinds)
        count = sparse.shape[0]
        queries = torch.cat([decoder.iou_token.weight, decoder.mask_tokens.weight]).unsqueeze(0).expand(count, -1, -1)
        absent = self.sam.prompt_encoder.no_mask_embed.weight.reshape(1, -1, 1, 1)
        # Until image features attend to prompts, they are the same for all: broadcasting computes them once.
        tokens, image = decoder.transformer(embeddings + absent, self.positions, torch.cat([queries, sparse], dim=1))
        masks = decoder.num_mask_tokens
        upscaled = decoder.output_upscaling(image.transpose(1, 2).reshape(-1, 256, 64, 64))
        kernels = torch.stack(
            [decoder.output_hypernetworks_mlps[index](tokens[:, 1 + index]) for index in range(masks)], dim=1
        )
        logits = (kernels @ upscaled.reshape(-1, 32, 256 * 256)).reshape(-1, masks, 256, 256)
        return logits, decoder.iou_prediction_head(tokens[:, 0])


def _pretend(name: str, **members: Any) -> None:
    module = types.ModuleType(name)
    module.__path__ = []
    vars(module).update(members)
    sys.modules[name] = module


def _network(carriers: Path, work: Path) -> tuple[Any, Any]:
    """Returns the model with its weights, and the decoder's ONNX wrapper class."""
    package = work / "mobile_sam_code"
    for source in carriers.glob("*.py"):
        # Carriers are flat: "modeling.common.py" was modeling/common.py.
        *folders, stem, _ = source.name.split(".")
        place = package.joinpath(*folders)
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, place / f"{stem}.py")
    sys.path.insert(0, str(work))
    _pretend("timm")
    _pretend("timm.models")
    _pretend(
        "timm.models.layers",
        DropPath=_DropPath,
        to_2tuple=lambda x: tuple(x) if isinstance(x, tuple | list) else (x, x),
        trunc_normal_=nn.init.trunc_normal_,
    )
    _pretend("timm.models.registry", register_model=lambda function: function)
    sam = importlib.import_module("mobile_sam_code.build_sam").build_sam_vit_t()
    sam.load_state_dict(torch.load(carriers / "mobile_sam.pt", map_location="cpu", weights_only=True))
    return sam.eval(), importlib.import_module("mobile_sam_code.utils.onnx").SamOnnxModel


def _main(carriers: Path, target: Path, packages: Path) -> None:
    sys.path.append(str(packages))
    warnings.simplefilter("ignore")
    sam, wrapper = _network(carriers, packages)
    options: dict[str, Any] = {"opset_version": _OPSET, "dynamo": False}
    with torch.no_grad():
        torch.onnx.export(
            _Encoder(sam).eval(),
            (torch.zeros(1, 3, _SIDE, _SIDE),),
            str(target / "mobile_sam_encoder.onnx"),
            input_names=["image"],
            output_names=["image_embeddings"],
            **options,
        )
        inputs = {
            "image_embeddings": torch.randn(1, 256, 64, 64),
            "point_coords": torch.rand(1, 5, 2) * _SIDE,
            "point_labels": torch.ones(1, 5),
            "mask_input": torch.zeros(1, 1, 256, 256),
            "has_mask_input": torch.zeros(1),
            "orig_im_size": torch.tensor([750.0, 1000.0]),
        }
        torch.onnx.export(
            wrapper(sam, return_single_mask=False),
            tuple(inputs.values()),
            str(target / "mobile_sam_decoder.onnx"),
            input_names=list(inputs),
            output_names=["masks", "iou_predictions", "low_res_masks"],
            dynamic_axes={"point_coords": {1: "num_points"}, "point_labels": {1: "num_points"}},
            **options,
        )
        prompts = {0: "prompts", 1: "num_points"}
        torch.onnx.export(
            _BatchDecoder(sam, wrapper).eval(),
            (torch.randn(1, 256, 64, 64), torch.rand(3, 2, 2) * _SIDE, torch.ones(3, 2)),
            str(target / "mobile_sam_decoder_batch.onnx"),
            input_names=["image_embeddings", "point_coords", "point_labels"],
            output_names=["low_res_masks", "iou_predictions"],
            dynamic_axes={
                "point_coords": prompts,
                "point_labels": prompts,
                "low_res_masks": {0: "prompts"},
                "iou_predictions": {0: "prompts"},
            },
            **options,
        )


if __name__ == "__main__":
    _main(*map(Path, sys.argv[1:4]))
