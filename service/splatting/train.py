"""The paper's single phase: geometry, colour, codes and the affine map W are optimised together."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.evidence import posterior
from fastsplat.service.scene.types import Gaussians, LabelMode
from fastsplat.service.splatting.checkpoint import Checkpoint, fingerprint_of, read_checkpoint, write_checkpoint
from fastsplat.service.splatting.consensus import voted_maps
from fastsplat.service.splatting.densify import planned_count
from fastsplat.service.splatting.evidence import views_evidence
from fastsplat.service.splatting.initial import scene_extent, start_gaussians, start_points
from fastsplat.service.splatting.losses import image_loss
from fastsplat.service.splatting.memory import release_free_memory
from fastsplat.service.splatting.quality import psnr, ssim
from fastsplat.service.splatting.raster import Splats, device_of, rasterize, sh_to_rgb
from fastsplat.service.splatting.result import color_parameters, final_scene, ghosts_of, present_gaussians
from fastsplat.service.splatting.schedule import (
    event_due,
    image_level,
    image_scales,
    learning_rates,
    run_share,
    sh_degree,
)
from fastsplat.service.splatting.semantics import (
    class_weights,
    code_size,
    label_loss,
    separated_codes,
    start_codes,
    start_head,
)
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.state import adam_step, new_state, relocate_and_grow, restored_state
from fastsplat.service.splatting.threads import one_torch_thread
from fastsplat.service.splatting.thrift import JUDGES, seen_weight, without_surplus
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat.service.splatting.views import Frame, TrainingView, capture_split, load_views, speaking, with_labels
from fastsplat_contract.errors import InvalidInputError, TrainingDivergedError

_AGREED = "agreed."
_REPORT_EVERY_S = 0.5
_PSNR_EVERY = 20


def train(
    capture: Capture,
    labelling: Labelling,
    settings: TrainingSettings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
) -> TrainedSplats:
    """Trains a scene until `settings.iterations` or `settings.time_budget_s`, whichever comes first.

    Args:
        capture: views with poses, and points (few or none are made up for by random ones).
        labelling: one label map per view; an empty dictionary trains without semantics (codes of size 0).
        progress: hears of metrics loss, psnr (held-out views, or the last training view when none is held out),
            gaussians, iterations_per_second, seconds_left; may raise `CancelledError`, which ends the run at once.
        checkpoint_dir: where the run's state is kept; a checkpoint found there is continued, to the bit when
            the run is bounded by iterations alone.

    Raises:
        InvalidInputError: no views, points that are not finite, images that contradict their cameras.
        ModelUnavailableError: backend cuda without an NVIDIA GPU or gsplat.
        ConflictError: the checkpoint belongs to another run.
        TrainingDivergedError: the loss or a Gaussian became NaN or infinite.
    """
    if not capture.views:
        raise InvalidInputError("the capture has no registered views", field="capture.views")
    if labelling.label_maps and len(labelling.label_maps) != len(capture.views):
        raise InvalidInputError(
            f"{len(labelling.label_maps)} label maps for {len(capture.views)} views", field="labelling.label_maps"
        )
    device_of(settings.backend)  # at once, not after the images have been read
    with one_torch_thread():
        return _Run(capture, labelling, settings, progress, checkpoint_dir).finish()


@dataclass(frozen=True)
class _Measured:
    psnr: float
    ssim: float


class _Run:
    def __init__(
        self,
        capture: Capture,
        labelling: Labelling,
        settings: TrainingSettings,
        progress: Progress,
        checkpoint_dir: Path | None,
    ) -> None:
        self.settings, self.progress, self.checkpoint_dir = settings, progress, checkpoint_dir
        progress(ProgressEvent("training", 0.0, f"loading {len(capture.views)} images"))
        kept, held_out = capture_split(capture, settings.held_out_every)
        self.views = speaking(load_views(capture, labelling, kept, settings.max_side, image_scales(settings)))
        self.held_out = load_views(capture, labelling, held_out, settings.max_side, (1.0,))
        self.labels = len(labelling.dictionary) if labelling.label_maps else 0
        self.label_mode: LabelMode = "evidence" if settings.label_mode == "evidence" else "codes"
        self.undetected_weight = 1.0 if labelling.exact else settings.undetected_weight
        self.regions = tuple(labelling.regions[index] for index in kept) if labelling.regions and self.labels else ()
        self.expected, self.voted = labelling.expected, False
        self.device = device_of(settings.backend)
        self.class_weights = class_weights(self.labels + 1, self.undetected_weight).to(self.device)
        start = start_points(capture.points, capture.point_colors, self.views, settings.max_gaussians, settings.seed)
        self.random_points = start.random
        self.start_count = len(start.points)
        self.extent = scene_extent(self.views, start.points)
        self.fingerprint = fingerprint_of(
            settings.model_dump(mode="json"),
            tuple(view.posed.name for view in capture.views),
            tuple(entry.label for entry in labelling.dictionary.entries),
            capture.points.tobytes(),
        )
        found = read_checkpoint(checkpoint_dir, self.fingerprint) if checkpoint_dir else None
        self.elapsed = found.elapsed_s if found else 0.0
        size = code_size(self.labels, settings.code_size) if self.label_mode == "codes" else 0
        self.class_codes = separated_codes(self.labels + 1, size, settings.seed)
        if found:
            agreed = {name: found.tensors[name] for name in found.tensors if name.startswith(_AGREED)}
            parameters = {name: value for name, value in found.tensors.items() if name not in agreed}
            self.state = restored_state(parameters, found.iteration, self.device)
            if agreed:
                self._agree([agreed[f"{_AGREED}{index}"].numpy() for index in range(len(self.views))])
        else:
            gaussians = start_gaussians(start, self.extent)
            weight, bias = start_head(self.class_codes)
            rest = (settings.max_sh_degree + 1) ** 2 - 1
            self.state = new_state(
                {
                    "means": torch.from_numpy(gaussians.means),
                    "quats": torch.from_numpy(gaussians.quats),
                    "log_scales": torch.from_numpy(gaussians.log_scales),
                    "logit_opacities": torch.from_numpy(gaussians.logit_opacities),
                    "sh_dc": torch.from_numpy(gaussians.sh_dc)[:, None, :],
                    "sh_rest": torch.zeros(self.start_count, rest, 3),
                    "codes": start_codes(gaussians.means, self.views, self.class_codes),
                    "weight": weight,
                    "bias": bias,
                },
                self.device,
            )
        if self.device.type != "cpu":
            self.views = tuple(view.to(self.device) for view in self.views)
            self.held_out = tuple(view.to(self.device) for view in self.held_out)
        self.losses: deque[float] = deque(maxlen=50)
        self.latest = math.nan
        self.speed = 0.0

    def finish(self) -> TrainedSplats:
        self._optimise()
        self._vote_if_due(1.0)
        trained, head = final_scene(self.state, self.settings.cull_opacity)
        gaussians = self._without_surplus(trained)
        quality = {
            "iterations": float(self.state.iteration),
            "gaussians": float(len(gaussians)),
            "train_seconds": self.elapsed,
            "held_out": float(len(self.held_out)),
            "random_points": float(self.random_points),
            "surplus_gaussians": float(len(trained) - len(gaussians)),
            "sh_degree": float(gaussians.sh_degree),
        }
        if self.losses:
            quality["loss"] = sum(self.losses) / len(self.losses)
        evidence = None
        if self.label_mode == "evidence":
            begun = time.monotonic()
            evidence = views_evidence(
                gaussians,
                self.views,
                self.labels + 1,
                undetected_weight=self.undetected_weight,
                backend=self.settings.backend,
            )
            quality["evidence_seconds"] = time.monotonic() - begun
        elif self.labels:
            quality["ghost_share"] = ghosts_of(gaussians, head)
        if self.held_out:
            measured = self._measure(color_parameters(gaussians), self.held_out)
            quality |= {"psnr": measured.psnr, "ssim": measured.ssim}
        self._report(1.0)
        return TrainedSplats(gaussians, head, quality, tuple(view.name for view in self.held_out), evidence)

    def _optimise(self) -> None:
        begun = last_report = last_checkpoint = time.monotonic()
        begun -= self.elapsed
        first_iteration, first_elapsed = self.state.iteration, self.elapsed
        share = run_share(self.state.iteration, self.elapsed, self.settings)
        self._report(share)
        while share < 1:
            self._vote_if_due(share)
            self._step(share)
            now = time.monotonic()
            self.elapsed = now - begun
            before, share = share, run_share(self.state.iteration, self.elapsed, self.settings)
            if event_due(before, share, self.settings.densify_events):
                self._densify(share)
            if self.held_out and event_due(before, share, self.settings.evaluations):
                self.latest = self._measure(self.state.parameters, self.held_out).psnr
                release_free_memory()
                last_report = -math.inf
            if now - last_report >= _REPORT_EVERY_S:
                self.speed = (self.state.iteration - first_iteration) / max(self.elapsed - first_elapsed, 1e-9)
                self._report(share)
                last_report = now
            if self.checkpoint_dir and now - last_checkpoint >= self.settings.checkpoint_every_s:
                self._checkpoint()
                last_checkpoint = now
        if self.checkpoint_dir:
            self._checkpoint()

    def _step(self, share: float) -> None:
        settings, iteration = self.settings, self.state.iteration
        view = self._view_of(iteration)
        frame = view.frames[image_level(share, settings)]
        semantic = self.label_mode == "codes" and self.labels > 0 and frame.labels is not None
        semantic = semantic and (self.voted or not self.regions)
        semantic = semantic and iteration % settings.semantic_every == 0
        parameters = self.state.parameters
        opacities, scales = torch.sigmoid(parameters["logit_opacities"]), torch.exp(parameters["log_scales"])
        degree = sh_degree(share, settings)
        image, culled = self._render(parameters, opacities, scales, view, frame, degree, semantic, self._background())
        # Split, not sliced: the backward pass of two slices would fill and add two whole images.
        rgb, codes = torch.split(image, [3, image.shape[2] - 3], dim=2)
        target = frame.target()
        loss = image_loss(rgb, target, settings.ssim_weight, frame.valid)
        if not self.held_out and iteration % _PSNR_EVERY == 0:
            self.latest = psnr(rgb.detach(), target, frame.valid)
        if semantic and frame.labels is not None:
            cross_entropy = label_loss(codes, parameters, frame.labels, frame.valid, self.class_weights)
            loss = loss + settings.semantic_weight * settings.semantic_every * cross_entropy
        if settings.opacity_decay:
            loss = loss + settings.opacity_decay * opacities.mean()
        if settings.scale_decay:
            loss = loss + settings.scale_decay / self.extent * scales.mean()
        value = loss.item()
        if not math.isfinite(value) or culled:
            raise TrainingDivergedError(
                f"at iteration {iteration} the loss is {value} and {culled} Gaussians are not finite",
                hint="Lower the learning rates in training.rates, and check the poses and points of the capture.",
                field="training.rates",
            )
        self.losses.append(value)
        del image, rgb, codes  # the backward pass needs the room, not them
        loss.backward()  # type: ignore[no-untyped-call]
        adam_step(self.state, learning_rates(share, self.extent, settings), settings.backend)

    def _render(
        self,
        parameters: Mapping[str, Tensor],
        opacities: Tensor,
        scales: Tensor,
        view: TrainingView,
        frame: Frame,
        degree: int,
        semantic: bool,
        background: Tensor | None,
    ) -> tuple[Tensor, int]:
        """[H, W, 3 + D] (or 3) and the number of non-finite Gaussians."""
        backend = self.settings.backend
        sh = parameters["sh_dc"]
        if degree:
            sh = torch.cat([sh, parameters["sh_rest"][:, : (degree + 1) ** 2 - 1]], dim=1)
        features = sh_to_rgb(parameters["means"], sh, view.position, degree, backend=backend)
        if semantic:
            features = torch.cat([features, parameters["codes"]], dim=1)
            if background is not None:
                background = torch.cat([background, background.new_zeros(features.shape[1] - 3)])
        splats = Splats(parameters["means"], parameters["quats"], scales, opacities, features)
        rendering = rasterize(splats, view.viewmat, frame.camera, background=background, backend=backend)
        return rendering.image, rendering.culled_non_finite

    def _view_of(self, iteration: int) -> TrainingView:
        """Every view once an epoch, in an order of the epoch's own: nothing to store in a checkpoint."""
        epoch, position = divmod(iteration, len(self.views))
        order = np.random.default_rng((self.settings.seed, 2, epoch)).permutation(len(self.views))
        return self.views[int(order[position])]

    def _background(self) -> Tensor | None:
        if self.settings.background == "black":
            return None
        generator = np.random.default_rng((self.settings.seed, 3, self.state.iteration))
        return torch.from_numpy(generator.uniform(size=3).astype(np.float32)).to(self.device)

    def _vote_if_due(self, share: float) -> None:
        """Lets the views agree on what was detected, once; in evidence mode as late as possible."""
        due = 1.0 if self.label_mode == "evidence" else self.settings.vote_at
        if self.voted or not self.regions or share < due:
            return
        settings = self.settings
        maps, evidence = voted_maps(
            present_gaussians(self.state),
            self.views,
            self.regions,
            self.labels + 1,
            expected=self.expected,
            undetected_weight=settings.agreed_undetected_weight,
            backend=settings.backend,
        )
        self._agree(maps)
        if self.label_mode == "codes":
            classes = torch.from_numpy(posterior(evidence, self.labels + 1).classes.astype(np.int64))
            self.state.parameters["codes"].data.copy_(self.class_codes[classes])
        release_free_memory()

    def _agree(self, maps: Sequence[NDArray[np.integer]]) -> None:
        self.voted = True
        self.undetected_weight = self.settings.agreed_undetected_weight
        self.class_weights = class_weights(self.labels + 1, self.undetected_weight).to(self.device)
        named = [with_labels(view, labels) for view, labels in zip(self.views, maps, strict=True)]
        self.views = tuple(view.to(self.device) for view in speaking(tuple(named)))

    def _densify(self, share: float) -> None:
        settings = self.settings
        if not settings.densify_from <= share <= settings.densify_until:
            return
        target = planned_count(
            share, self.start_count, settings.max_gaussians, settings.densify_from, settings.full_count_at
        )
        seed = np.random.SeedSequence((settings.seed, 4, self.state.iteration)).generate_state(1, np.uint64)
        generator = torch.Generator().manual_seed(int(seed[0] >> 1))
        need = torch.sigmoid(self.state.parameters["logit_opacities"].detach())
        relocate_and_grow(self.state, need, target, settings.dead_opacity, generator)
        release_free_memory()

    def _without_surplus(self, gaussians: Gaussians) -> Gaussians:
        """See `TrainingSettings.surplus_loss_db`; a few of the held-out views judge."""
        allowed = self.settings.surplus_loss_db
        if not allowed or not self.held_out:
            return gaussians
        judges = self.held_out[:: math.ceil(len(self.held_out) / JUDGES)]
        weight = seen_weight(gaussians, self.views, self.settings.backend)
        left = without_surplus(
            gaussians, weight, lambda some: self._measure(color_parameters(some), judges).psnr, allowed
        )
        return left.gaussians

    @torch.no_grad()
    def _measure(self, parameters: Mapping[str, Tensor], views: tuple[TrainingView, ...]) -> _Measured:
        degree = math.isqrt(1 + parameters["sh_rest"].shape[1]) - 1
        parameters = {name: value.to(self.device) for name, value in parameters.items()}
        opacities, scales = torch.sigmoid(parameters["logit_opacities"]), torch.exp(parameters["log_scales"])
        results = []
        for view in views:
            frame = view.frames[-1]
            image, _ = self._render(parameters, opacities, scales, view, frame, degree, False, None)
            target = frame.target()
            results.append((psnr(image, target, frame.valid), ssim(image, target, frame.valid)))
        return _Measured(*(float(np.mean(values)) for values in zip(*results, strict=True)))

    def _checkpoint(self) -> None:
        assert self.checkpoint_dir is not None
        tensors = self.state.tensors()
        if self.voted:
            blank = torch.zeros(1, 1, dtype=torch.uint8)
            for index, view in enumerate(self.views):
                labels = view.frames[-1].labels
                tensors[f"{_AGREED}{index}"] = blank if labels is None else labels.cpu()
        checkpoint = Checkpoint(self.state.iteration, self.elapsed, tensors)
        write_checkpoint(checkpoint, self.checkpoint_dir, self.fingerprint)

    def _report(self, share: float) -> None:
        settings = self.settings
        left = (settings.iterations - self.state.iteration) / self.speed if self.speed else math.inf
        if settings.time_budget_s is not None:
            left = min(left, max(0.0, settings.time_budget_s - self.elapsed))
        metrics = {
            "iteration": float(self.state.iteration),
            "elapsed_s": self.elapsed,
            "gaussians": float(self.state.count),
            "iterations_per_second": self.speed,
            "random_points": float(self.random_points),
        }
        if self.losses:
            metrics["loss"] = sum(self.losses) / len(self.losses)
        if math.isfinite(left):
            metrics["seconds_left"] = left
        if math.isfinite(self.latest):
            metrics["psnr"] = self.latest
        message = f"iteration {self.state.iteration}, {self.state.count} Gaussians"
        self.progress(ProgressEvent("training", share, message, metrics))
