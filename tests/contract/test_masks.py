"""Run lengths and packed bits: exact inverses, COCO's own letters, bounded decoding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pycocotools import mask as oracle

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.masks import decode_rle, encode_rle, pack_bits, unpack_bits

masks = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=40))
blocks = st.tuples(st.integers(1, 300), st.integers(1, 300), st.integers(0, 300), st.integers(0, 300)).map(
    lambda b: np.add.outer(np.arange(b[0]) < b[2], np.arange(b[1]) < b[3]) == 2
)


@given(st.one_of(masks, blocks))
def test_decoding_undoes_encoding(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(decode_rle(encode_rle(mask), *mask.shape), mask)


@given(st.one_of(masks.filter(lambda mask: mask.size > 0), blocks))
def test_letters_are_those_of_pycocotools(mask: np.ndarray) -> None:
    assert encode_rle(mask) == oracle.encode(np.asfortranarray(mask, dtype=np.uint8))["counts"].decode()


@pytest.mark.parametrize(
    ("counts", "height", "width"),
    [
        ("5", 2, 3),
        ("7", 2, 3),
        ("", 2, 3),
        ("P", 4, 8),
        ("é", 2, 3),
        ("\x00", 2, 3),
        ("?", 2, 3),
        ("o" * 5000, 2, 3),
        ("6", -2, -3),
        ("6", 10**6, 10**6),
    ],
)
def test_bad_counts(counts: str, height: int, width: int) -> None:
    with pytest.raises(InvalidInputError):
        decode_rle(counts, height, width)


@given(st.text(alphabet=[chr(code) for code in range(48, 112)], max_size=30), st.integers(0, 20), st.integers(0, 20))
def test_any_letters_decode_or_are_refused(counts: str, height: int, width: int) -> None:
    try:
        mask = decode_rle(counts, height, width)
    except InvalidInputError:
        return
    assert mask.shape == (height, width)


@given(arrays(np.bool_, st.integers(0, 70)))
def test_packed_bits(mask: np.ndarray) -> None:
    packed = pack_bits(mask)
    assert len(packed) == -(-len(mask) // 8)
    np.testing.assert_array_equal(unpack_bits(packed, len(mask)), mask)
    if len(mask):
        assert bool(packed[0] & 0x80) == mask[0]


@pytest.mark.parametrize(("data", "count"), [(b"\x00", 9), (b"\x00\x00", 8), (b"\x01", 7), (b"", 1), (b"", -1)])
def test_bad_packed_bits(data: bytes, count: int) -> None:
    with pytest.raises(InvalidInputError):
        unpack_bits(data, count)
