"""Limits on uploads, and how camera poses are computed."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup
from fastsplat_contract.jobs.operations import Lens


class CaptureOptions(Options):
    """Bounds on what an upload may contain, on the processes that read it, and on structure from motion."""

    max_entries: int = 20_000
    """Files of one upload; entries of an archive, and the folders that they are in."""
    max_compression_ratio: int = 200
    """An archive that unpacks to more than so many times its size is refused as a decompression bomb."""
    max_pixels: int = 24_000_000_000
    """Width times height of all images, masks and label maps of an upload together: 2,000 photos of 12 megapixels."""
    min_frames_present: float = Field(0.5, ge=0, le=1)
    """Frames of a transforms.json whose image is missing from the upload are skipped and named in the warnings; the
    upload is refused when fewer than this share of its frames have their image."""
    max_json_bytes: int = 16 * 2**20
    """Bytes of a transforms.json or labels.json."""
    max_model_points: int = 5_000_000
    """Sparse points read from a COLMAP model or a PLY file."""
    max_video_frames_read: int = 36_000
    """Frames of a video, 20 minutes at 30 a second; a longer one is refused."""
    validation_memory_bytes: int = 6 * 2**30
    """Address space of the child process that checks an upload before it is acknowledged."""
    validation_seconds: int = 60
    """How long that check may take; its processor time is bounded by this on all cores."""
    sfm_threads: int = 0
    """Threads for features and matching; 0: one a core. The mapper runs on one, which makes its result repeatable."""
    sfm_max_side: int = 1_200
    """Features are detected at no more than this many pixels on the longer side."""
    sfm_features: int = 4_500
    """Features an image."""
    exhaustive_images: int = 15
    """Up to so many images every pair is matched; beyond, the `pairs_per_image` most promising of each image."""
    pairs_per_image: int = 10
    """Pairs of each image then."""
    panorama_face_side: int = Field(1_024, ge=32, le=8_192)
    """Pixels of each of the six square faces that a panorama is cut into, at most; it bounds memory, too."""
    global_mapping_images: int = Field(150, ge=2)
    """More images than this are placed all at once by COLMAP's global mapper, where its result is good; fewer one after
    another, which is slower for many."""
    last_tag: int = Field(586, ge=0, lt=587)
    """Highest id that counts."""
    min_points: int = 50
    """A reconstruction with fewer points is refused."""
    min_registered_share: float = 0.2
    """A reconstruction that registers a smaller share of the images is refused."""


class CaptureSettings(CaptureOptions, SettingGroup, section="capture"):
    """Every limit on an upload, and how camera poses are computed."""

    max_upload_bytes: int = 2 * 2**30
    """Bytes of one upload as sent."""
    max_unpacked_bytes: int = 8 * 2**30
    """Bytes of an archive's content."""
    max_image_pixels: int = 64_000_000
    """Width times height of an image or a video frame."""
    max_images: int = 2_000
    """Images of one scene."""
    max_side: int = 1_600
    """Images are reduced to this many pixels on the longer side before anything else is done with them."""
    max_phone_frames: int = Field(200, ge=2)
    """Of a recording of a phone (Polycam, Record3D, 3D Scanner App) at most so many frames are used, evenly spread."""
    max_splat_gaussians: int = Field(5_000_000, ge=1)
    """Gaussians of a splat that is to become a scene."""
    video_frames: int = 80
    """Frames used of a video: the sharpest of so many equal intervals."""
    sfm_memory_bytes: int = 8 * 2**30
    """Address space of the child process that runs structure from motion."""
    sfm_seconds: int = 4 * 3600
    """How long structure from motion may take."""
    lens: Lens = "auto"
    """What photos and videos without poses were taken with: "auto" (those whose metadata say so are 360° panoramas, all
    others perspective), "fisheye", or "panorama" (equirectangular, 360° × 180°). A scene may be posted with its own."""
    nadir_deg: float = Field(0.0, ge=0, le=80)
    """Of panoramas: pixels within so many degrees of straight down, where the photographer stands, are left out."""
    panorama_frames: int = Field(30, ge=2)
    """Frames used of a 360° video; each becomes six images."""
    tag_side_m: float | None = Field(0.08, gt=0)
    """Printed side of the black square of AprilTags (family 36h11) that give photos without known poses their meters,
    as `fastsplat tags` prints them; None: tags are not looked for."""
    first_tag: int = Field(560, ge=0, lt=587)
    """Lowest id that counts, the first that `fastsplat tags` prints; a room's own tags rarely have such high ids."""


class PhotoSettings(SettingGroup, section="photos"):
    """Which photos stay with a scene once it is made."""

    keep: Literal["on", "off"] = "on"
    """Whether small copies of the photos stay with the scene, for everybody who may read it. "off", e.g. where they
    show people: no photo outlives its upload. That holds for scenes made from then on."""
    max_side: int = Field(1024, ge=64, le=8_192)
    """Pixels of a copy's longer side at most."""
    quality: int = Field(90, ge=10, le=95)
    """Of the copies' JPEG: 90 is about 200 kB at 1024 pixels."""
