"""Rasterizer, losses and Adam for the CPU."""

from collections.abc import Callable
from typing import Annotated

import numpy
from numpy.typing import NDArray

class TooManyIsectsError(Exception):
    pass

class CallCancelledError(Exception):
    pass

def set_cancellation_check(check: Callable[[], None]) -> None:
    """
    Calls `check` about twenty times a second during long calls; what it raises ends the call.
    """

def available_isas() -> list[str]:
    """Instruction sets this machine can run, best first."""

MAX_GROUP: int = 16

MAX_SH_DEGREE: int = 3

TILE_HEIGHT: int = 16

class Camera:
    """Pinhole intrinsics in pixels."""

    def __init__(self, *, width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> None: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...

class RasterSettings:
    """As `raster.types.RasterSettings`."""

    def __init__(
        self,
        *,
        alpha_min: float,
        alpha_max: float,
        transmittance_min: float,
        near: float,
        far: float,
        eps2d: float,
        max_isects: int,
    ) -> None: ...
    @property
    def alpha_min(self) -> float: ...
    @property
    def alpha_max(self) -> float: ...
    @property
    def transmittance_min(self) -> float: ...
    @property
    def near(self) -> float: ...
    @property
    def far(self) -> float: ...
    @property
    def eps2d(self) -> float: ...
    @property
    def max_isects(self) -> int: ...

class RenderContext:
    """One prepared view: Gaussians projected, sorted and binned."""

    @property
    def non_finite(self) -> int: ...
    @property
    def visible(self) -> int: ...
    @property
    def isects(self) -> int: ...
    @property
    def milliseconds(self) -> dict[str, float]: ...
    def forward(
        self,
        *,
        background: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
        alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
        depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
        median_depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
        first_row: int = 0,
    ) -> None:
        """
        Composites as many rows as `image` has, from `first_row` on: both whole rows of tiles.
        """

    def backward(
        self,
        *,
        means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        quats: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
        scales: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
        opacities: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        features: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
        background: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        grad_image: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
        ]
        | None,
        grad_alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)]
        | None,
        grad_depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)]
        | None,
        d_means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
        d_quats: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C", device="cpu")],
        d_scales: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
        d_opacities: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
        d_features: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
        d_pose: Annotated[NDArray[numpy.float64], dict(shape=(12), order="C", device="cpu")] | None,
    ) -> None:
        """
        Gradients of the inputs; d_pose is that of camera-from-world: rotation [9], translation [3].
        """

    def accumulate_weights(
        self,
        *,
        values: Annotated[
            NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)
        ],
        sums: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    ) -> None:
        """sums[g] = Σ_p w_g(p)·values(p)."""

    def label_map(
        self,
        *,
        weight: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
        bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        relevancy: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)]
        | None,
        alpha_min: float,
        classes: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order="C", device="cpu")],
        alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
        expected: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")] | None,
        image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    ) -> None: ...
    def share_map(
        self,
        *,
        starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
        labels: Annotated[NDArray[numpy.uint16], dict(shape=(None,), order="C", device="cpu", writable=False)],
        shares: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
        alpha_min: float,
        classes: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order="C", device="cpu")],
        alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    ) -> None: ...
    def label_sums(
        self,
        *,
        labels: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
        max_entries: int,
        starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu")],
    ) -> int:
        """Fills `starts` and returns the number of entries."""

    def label_entries(
        self,
        *,
        starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
        labels: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
        sums: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
    ) -> None:
        """The entries of the last `label_sums`."""

def prepare(
    *,
    means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    quats: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    scales: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    opacities: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    features: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    viewmat: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    camera: Camera,
    settings: RasterSettings,
    radii: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu")],
    threads: int,
    isa: str,
) -> RenderContext:
    """Projects, sorts and bins; fills `radii`."""

MAX_CODE_SIZE: int = 64

def image_loss(
    *,
    image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    target: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    valid: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order="C", device="cpu", writable=False)] | None,
    ssim_weight: float,
    grad: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")] | None,
    threads: int,
    isa: str,
) -> float: ...
def cross_entropy(
    *,
    codes: Annotated[NDArray[numpy.float32], dict(shape=(None, None), device="cpu", writable=False)],
    weight: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    labels: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    class_weights: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    d_codes: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    d_weight: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    d_bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu")],
    threads: int,
    isa: str,
) -> float: ...
def surface_loss(
    *,
    alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    squared: Annotated[NDArray[numpy.float32], dict(shape=(None, None), device="cpu", writable=False)],
    target: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    valid: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order="C", device="cpu", writable=False)] | None,
    alpha_min: float,
    step: int,
    spread_weight: float,
    smoothness_weight: float,
    d_alpha: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    d_depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    d_squared: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    threads: int,
    isa: str,
) -> float: ...
def spherical_harmonics(
    *,
    means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    sh: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    camera_position: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    degree: int,
    rgb: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
    threads: int,
    isa: str,
) -> None: ...
def spherical_harmonics_backward(
    *,
    means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    sh: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    camera_position: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    degree: int,
    grad: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    d_means: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
    d_sh: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")],
    threads: int,
    isa: str,
) -> None: ...
def adam(
    *,
    param: Annotated[NDArray[numpy.float32], dict(order="C", device="cpu")],
    grad: Annotated[NDArray[numpy.float32], dict(order="C", device="cpu", writable=False)],
    exp_avg: Annotated[NDArray[numpy.float32], dict(order="C", device="cpu")],
    exp_avg_sq: Annotated[NDArray[numpy.float32], dict(order="C", device="cpu")],
    lr: float,
    beta1: float,
    beta2: float,
    eps: float,
    step: int,
    threads: int,
    isa: str,
) -> None: ...
def count_contributing(context: RenderContext) -> int:
    """Pixel-Gaussian pairs that count in a view after its forward pass."""

def peak_fma(threads: int, isa: str) -> tuple[float, int]:
    """
    Vector multiply-adds a nanosecond that `threads` threads reach together, and the lanes of a vector.
    """
