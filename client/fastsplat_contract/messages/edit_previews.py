"""What edits would remove, before they are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Int64, Many, Request, Response
from fastsplat_contract.masks import unpack_bits
from fastsplat_contract.messages.scenes import Edit, OfScene, Version


@dataclass(frozen=True)
class PreviewEditIn(Request):
    """Edits whose action is remove, as `EditIn` has them; nothing is changed."""

    proto: ClassVar[str] = "PreviewEditRequest"

    edits: Annotated[Many[Edit], Field(description="at least one, in order; their action is remove")]
    version: Version = ""


@dataclass(frozen=True)
class PreviewEditRequest(PreviewEditIn, OfScene):
    """Edits of one scene whose action is remove; nothing is changed."""


@dataclass(frozen=True)
class EditPreview(Response):
    """What edits would remove from a version. Made, those that remove everything are refused, as are idle filters."""

    version: Annotated[str, Field(description="which version was read")]
    gaussians: Annotated[Int64, Field(description="that it has")]
    count: Annotated[Int64, Field(description="of Gaussians that all edits together would remove")]
    counts: Annotated[Many[Int64], Field(description="that each edit would remove of what those before it left")]
    mask3d: Annotated[
        Base64, Field(description="what would go: one bit per Gaussian in row order, most significant bit first")
    ]

    def array(self) -> NDArray[np.bool_]:
        """bool [gaussians]: which would go."""
        return unpack_bits(self.mask3d, self.gaussians)
