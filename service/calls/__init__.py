"""The one service layer behind both faces."""

from service.calls.service import SceneService, open_service
from service.calls.uploads import UploadSession

__all__ = ["SceneService", "UploadSession", "open_service"]
