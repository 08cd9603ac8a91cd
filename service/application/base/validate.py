"""Validation of requests before any work."""

from __future__ import annotations

import math
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_args

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.planning.presets import preset_name
from fastsplat.service.settings import Settings, StoreOptions
from fastsplat_contract.codec.unseen_characters import check_seen
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.operations import (
    MAX_NADIR_DEG,
    MAX_PRIORITY,
    MAX_TOLERANCE_DB,
    MIN_TOLERANCE_DB,
    Lens,
    Movers,
    Privacy,
    SceneOptions,
    UpAxis,
)
from fastsplat_contract.messages.objects import PickRequest

_MAX_NAME_CHARS = 200
"""Limit of a scene's name."""
_MAX_TIME_BUDGET_S = 24 * 3600.0
"""Limit of a scene's time budget."""

_DEFAULT_PAGE = 50
_CHOICES = {"up": UpAxis, "movers": Movers, "privacy": Privacy, "lens": Lens}
_RANGES = {
    "tolerance_db": (MIN_TOLERANCE_DB, MAX_TOLERANCE_DB, " dB", "0.3 is the default; less takes longer."),
    "nadir_deg": (0.0, MAX_NADIR_DEG, "°", "25 hides a photographer or a tripod."),
    "priority": (-MAX_PRIORITY, MAX_PRIORITY, "", "0 is usual."),
}
"""Options of a new scene with their least and largest value, its unit, and a hint."""


def check_texts(value: object, field: str = "") -> None:
    """Raises `InvalidInputError` for any text with NUL or a lone surrogate, naming its field.

    `value` is a text, a number, or a dataclass, sequence or set of such.
    """
    if isinstance(value, str):
        if re.search("[\0\ud800-\udfff]", value):
            raise InvalidInputError(
                "a text with a NUL character or half of a surrogate pair", field=field, hint="Send plain Unicode text."
            )
    elif is_dataclass(value) and not isinstance(value, type):
        for part in fields(value):
            check_texts(getattr(value, part.name), f"{field}.{part.name}" if field else part.name)
    elif isinstance(value, (tuple, list)):
        for number, part in enumerate(value):
            check_texts(part, f"{field}[{number}]")
    elif isinstance(value, (set, frozenset)):
        for part in value:
            check_texts(part, field)


def check_pick(request: PickRequest) -> None:
    """Raises `InvalidInputError` unless a request names one place, with a camera if in a picture."""
    places = [name for name in ("pixel", "box", "point") if getattr(request, name) is not None]
    if len(places) != 1:
        raise InvalidInputError(
            f"{len(places)} places to pick at",
            field=(places or ["pixel"])[-1],
            hint="Send one of pixel, box and point.",
        )
    if places != ["point"] or not (request.camera is None and request.view is None):
        check_viewpoint(places[0], request.camera, request.view)


def check_viewpoint(subject: str, camera: PosedCamera | None, view: str | None) -> None:
    """Raises `InvalidInputError` unless exactly one of camera and view is there."""
    if (camera is None) == (view is None):
        raise InvalidInputError(
            f"a {subject} needs exactly one of camera and view", field="view", hint="Name a view or send a pose."
        )


def check_page_size(size: int, limits: StoreOptions) -> int:
    """Effective page size: default for 0, capped; raises `InvalidInputError` for a negative one."""
    if size < 0:
        raise InvalidInputError(f"a page size of {size}", field="page_size", hint="Use 0 for the default.")
    return min(size or _DEFAULT_PAGE, limits.max_page_size)


def check_request(name: str, request_id: str, options: SceneOptions, limits: StoreOptions) -> None:
    """Validates name, request id and options of a new scene.

    Raises:
        InvalidInputError: an invalid value.
        LimitExceededError: a value over the server's limits.
    """
    check_scene_name(name)
    check_request_id(request_id)
    check_texts(options)
    if len(options.labels) > limits.max_labels:
        raise LimitExceededError(f"{len(options.labels)} labels", field="labels", limit=f"{limits.max_labels} labels")
    for label in options.labels:
        _check_length("labels", label, limits.max_label_chars)
        if not label_key(label):
            raise InvalidInputError("an empty label", field="labels", hint="Leave empty labels out.")
        check_seen(label, "labels")
    _check_choices(options)
    _check_budgets(options, limits)


def check_scene_name(name: str) -> None:
    """Validates a scene's name ("": none): its length, and no invisible characters."""
    _check_length("name", name, _MAX_NAME_CHARS)
    check_seen(name, "name")


def check_splat_options(upload: ValidatedUpload, options: SceneOptions) -> None:
    """Validates options against the kind of upload.

    Raises:
        InvalidInputError: `up` without a lone splat, redaction of a splat, or a lens for an upload with cameras.
        LimitExceededError: the splat has more Gaussians than `max_gaussians`; none of its rows is left out.
    """
    if options.up is not None and upload.source != "splat":
        raise InvalidInputError(
            "up is stated for an upload that is not a splat alone",
            field="up",
            hint="Leave it out: photos and their poses say what is up.",
        )
    if (options.privacy or options.movers == "ignore") and upload.gaussians:
        raise InvalidInputError(
            "nothing can be withheld from a splat: its Gaussians stay as they are",
            field="privacy" if options.privacy else "movers",
            hint="Leave it out, or send the photos alone.",
        )
    if options.lens not in (None, "auto") and upload.source not in ("images", "video"):
        raise InvalidInputError(
            "a lens is stated for an upload that brings its cameras",
            field="lens",
            hint="Leave it out: the camera models beside the poses say what the lens is.",
        )
    if options.max_gaussians is not None and upload.gaussians > options.max_gaussians:
        raise LimitExceededError(
            f"the splat has {upload.gaussians} Gaussians",
            field="max_gaussians",
            limit=f"{options.max_gaussians} Gaussians (as posted)",
            hint="Leave max_gaussians out: no row of a splat is left out.",
        )


def check_seconds(seconds: float, field: str) -> None:
    """Validates a time budget: finite, above 0, within the server's limit."""
    if not math.isfinite(seconds) or seconds <= 0:
        raise InvalidInputError(
            f"a time budget of {seconds} s", field=field, hint="Give seconds above 0, or leave it out."
        )
    if seconds > _MAX_TIME_BUDGET_S:
        raise LimitExceededError(f"a time budget of {seconds} s", field=field, limit=f"{_MAX_TIME_BUDGET_S} s")


def check_request_id(request_id: str) -> None:
    """Raises `InvalidInputError` unless 1 to 200 printable ASCII characters, or "" for none."""
    if request_id and not re.fullmatch(r"[!-~]{1,200}", request_id):
        raise InvalidInputError(
            "the request id is not 1 to 200 printable ASCII characters without spaces",
            field="request_id",
            hint="Use a UUID.",
        )


def _check_choices(options: SceneOptions) -> None:
    if options.preset is not None:
        preset_name(options.preset)
        if options.tolerance_db is not None:
            raise InvalidInputError(
                "a preset and a tolerance", field="tolerance_db", hint="Leave one out: a preset is a tolerance."
            )
    for name, choices in _CHOICES.items():
        if (value := getattr(options, name)) is not None and value not in get_args(choices):
            raise InvalidInputError(
                f"{name} cannot be {value[:20]!r}", field=name, hint=f"Use one of {', '.join(get_args(choices))}."
            )
    if options.privacy is not None and options.movers == "keep":
        raise InvalidInputError(
            "people are to be withheld, and what moves is to be kept",
            field="movers",
            hint="Leave one of movers and privacy out.",
        )
    for name, (low, high, unit, hint) in _RANGES.items():
        if (number := getattr(options, name)) is not None and not low <= number <= high:
            raise LimitExceededError(
                f"{name} of {number:g}{unit}", field=name, limit=f"{low:g} to {high:g}{unit}", hint=hint
            )


def _check_budgets(options: SceneOptions, limits: StoreOptions) -> None:
    seconds, gaussians = options.time_budget_s, options.max_gaussians
    if seconds is not None:
        check_seconds(seconds, "time_budget_s")
    if gaussians is not None:
        if gaussians < 1:
            raise InvalidInputError(
                f"a budget of {gaussians} Gaussians", field="max_gaussians", hint="Give at least 1, or leave it out."
            )
        if gaussians > limits.max_gaussians:
            raise LimitExceededError(
                f"a budget of {gaussians} Gaussians", field="max_gaussians", limit=f"{limits.max_gaussians}"
            )


def _check_length(field: str, text: str, limit: int) -> None:
    if len(text) > limit:
        raise LimitExceededError(f"{field} of {len(text)} characters", field=field, limit=f"{limit} characters")


def admit_upload(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
    """Validates an upload in a separate process; raises as `validate_in_sandbox`."""
    from fastsplat.service.capture.untrusted.sandbox import (
        validate_in_sandbox,  # loads with the first upload, not with the server
    )

    return validate_in_sandbox(folder, settings, strict)


def check_labels(options: SceneOptions, upload: ValidatedUpload, settings: Settings) -> None:
    """Checks that configured detectors know the labels and what is to be redacted.

    Raises:
        InvalidInputError: unknown labels, without label maps.
        ModelUnavailableError: no detector knows people or movers, which are to be redacted.
    """
    withholds = options.privacy or options.movers == "ignore"
    if not withholds and (not options.labels or upload.has_labels):
        return  # avoids loading onnxruntime
    from fastsplat.service.perception.detectors.open_detectors import check_texts_known
    from fastsplat.service.perception.label_maps.capture_detection import check_labels_known
    from fastsplat.service.perception.label_maps.movers import mover_detectors

    if options.labels and not upload.has_labels:
        check_labels_known(options.labels, settings.perception)
        check_texts_known(options.labels, settings.perception, settings.models, field="labels")
    if withholds:
        mover_detectors(options.movers, options.privacy, settings.perception, settings.models)
