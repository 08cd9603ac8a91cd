"""Work that nobody waits for stops, and nothing else does."""

from __future__ import annotations

import threading

import pytest

from fastsplat.service.common.cancellation import Cancellation, cancellable, check_cancelled
from fastsplat_contract.errors import CancelledError


def test_only_the_call_that_was_cancelled_stops() -> None:
    mine, theirs = Cancellation(), Cancellation()
    mine.cancel()
    check_cancelled()
    with cancellable(theirs):
        check_cancelled()
        with cancellable(mine), pytest.raises(CancelledError):
            check_cancelled()
        check_cancelled()


def test_a_flag_is_seen_by_its_own_thread_alone() -> None:
    cancellation = Cancellation()
    cancellation.cancel()
    with cancellable(cancellation):
        thread = threading.Thread(target=check_cancelled)
        thread.start()
        thread.join()
        with pytest.raises(CancelledError):
            check_cancelled()
