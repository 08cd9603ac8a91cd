"""Discovery, appearance and reading of a scene's things, from its photos."""

from __future__ import annotations

from collections.abc import Callable

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.instances.naming.thing_appearances import with_appearances
from fastsplat.service.instances.naming.thing_reads import with_reads
from fastsplat.service.instances.scene_things import find_scene_things
from fastsplat.service.perception.appearance import open_appearance_encoder
from fastsplat.service.perception.image_text import find_image_text
from fastsplat.service.perception.label_maps.capture_masks import propose_capture_masks
from fastsplat.service.perception.readers.ppocr import find_reader
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Gaussians, Things
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats

THINGS_SHARE = 0.3
"""Share of the export's progress."""
_LOOKING_SHARE = 0.85
"""Share of `THINGS_SHARE` for proposing masks that perception did not."""
_READING_FROM = 0.95
"""Share of `THINGS_SHARE` at which reading begins."""


def is_private(capture: Capture, settings: Settings) -> bool:
    """True if photos are not kept, or people are redacted."""
    withheld = capture.report.withheld
    return settings.photos.keep == "off" or (withheld is not None and withheld.privacy is not None)


def find_things(
    trained: TrainedSplats,
    labelling: Labelling,
    capture: Capture,
    settings: Settings,
    progress: Progress,
    *,
    described: bool = True,
) -> tuple[Things | None, Gaussians]:
    """Discovers things, if any; also returns the Gaussians with their codes.

    Without detected regions, things are discovered only if `settings.discovery.things` is "on".

    Args:
        capture: if `is_private`, no text is read and no image-text model is run.
        progress: stage "export", up to `THINGS_SHARE`.
        described: also compute appearances and read text.

    Raises:
        ModelUnavailableError: the segmenter that discovery needs is missing, or another model's file is damaged.
    """
    looked_for, detected = labelling.masks, [regions.masks() for regions in labelling.regions]
    training, discovery, models = settings.training, settings.discovery, settings.models
    if not detected and discovery.things != "on":
        return None, trained.gaussians

    def tell(what: str, begin: float, end: float) -> Callable[[int, int], None]:
        def on_view(done: int, total: int) -> None:
            fraction = THINGS_SHARE * (begin + (end - begin) * done / total)
            progress(ProgressEvent("export", fraction, f"{what}, view {done}/{total}"))

        return on_view

    masks, begin = looked_for or detected, 0.0
    if not masks:
        looking, begin = tell("looking for things", 0, _LOOKING_SHARE), _LOOKING_SHARE
        masks = propose_capture_masks(capture.views, settings.perception, models, looking)
    on_view = tell("discovering things", begin, _READING_FROM)
    found = find_scene_things(trained.gaussians, capture, labelling, masks, discovery, on_view, training=training)
    things, gaussians = found
    if not things.table and not detected:
        return None, trained.gaussians
    if discovery.things == "off" or not described:
        return things, gaussians
    side, backend, private = discovery.max_side, training.backend, is_private(capture, settings)
    encoder = open_appearance_encoder(settings.perception, models)
    looks = None if private else find_image_text(settings.perception, models)
    if encoder or looks:
        things = with_appearances(things, gaussians, capture.views, encoder, side, looks=looks, backend=backend)
    if not private:
        reader, on_view = find_reader(settings.perception, models), tell("reading", _READING_FROM, 1.0)
        things = with_reads(things, gaussians, capture.views, reader, side, on_view, backend=backend)
    return things, gaussians
