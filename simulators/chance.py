"""Chance that belongs to a key: the same key gives the same numbers, whatever was drawn before."""

import hashlib

import numpy as np

Key = tuple[int | str, ...]


def uniform(*key: int | str) -> float:
    """A number in [0, 1)."""
    return int.from_bytes(_digest(key, 8), "big") / 2**64


def generator(key: Key) -> np.random.Generator:
    """A generator of as many numbers as wanted."""
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(key, 16), "little")))


def _digest(key: Key, size: int) -> bytes:
    return hashlib.blake2b(repr(key).encode(), digest_size=size).digest()
