"""The one service layer behind both faces: `service.calls.service`."""
