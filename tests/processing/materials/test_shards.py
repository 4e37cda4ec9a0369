"""Blocks of a stored BTF are what Zarr reads, each sample once."""

import numpy as np
import pytest
from zarr.codecs import ZstdCodec

import processing.products.btf as stored_btf
from processing.errors import ImageError
from processing.products import Btf, StoredBtf


@pytest.fixture
def folder(tmp_path, rng):
    """Shards of unequal size, and one that got lost."""
    ways = rng.normal(size=(20, 3))
    Btf(rng.random((10, 17, 37, 18, 3)).astype(np.float32), ways[:10], ways[:17]).save(tmp_path)
    (tmp_path / "btf.zarr" / "c" / "1" / "0" / "0" / "0" / "0").unlink()
    return tmp_path


@pytest.mark.parametrize("most", [1, 1 << 23])
def test_blocks_are_what_zarr_reads(folder, monkeypatch, most):
    """Also where a block is one row of chunks."""
    monkeypatch.setattr(stored_btf, "_BLOCK", most)
    stored = StoredBtf.open(folder)
    found = np.zeros(stored.shape, np.float32)
    for lights, rows, block in stored.blocks():
        found[lights, :, rows] += block
    np.testing.assert_array_equal(found, Btf.load(folder).reflectance)


def test_stores_in_another_coding_are_read(folder, monkeypatch):
    """As versions before this one wrote them."""
    kept = Btf.load(folder)
    monkeypatch.setattr(stored_btf, "CODING", {"compressors": ZstdCodec(level=0)})
    kept.save(folder)
    for lights, rows, block in StoredBtf.open(folder).blocks():
        np.testing.assert_array_equal(block, kept.reflectance[lights, :, rows])


def test_a_flipped_bit_is_found(folder):
    shard = folder / "btf.zarr" / "c" / "0" / "1" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(data)
    with pytest.raises(ImageError, match="checksum"):
        list(StoredBtf.open(folder).blocks())


def test_a_damaged_shard_is_named(folder):
    shard = folder / "btf.zarr" / "c" / "0" / "1" / "0" / "0" / "0"
    data = shard.read_bytes()
    for other in (data[:-9], data[: len(data) // 2], b"", data[:-4][::-1] + data[-4:]):
        shard.write_bytes(other)
        with pytest.raises(ImageError, match="not a whole shard"):
            list(StoredBtf.open(folder).blocks())
