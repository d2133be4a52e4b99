"""The array cache: one reading for all, bounded in bytes, the least recently used evicted first."""

from __future__ import annotations

import numpy as np

from yesnt.io.array_cache import ArrayCache


def fetch(cache: ArrayCache, key: object, made: list[object], size: int = 100) -> np.ndarray:
    def make() -> np.ndarray:
        made.append(key)
        return np.zeros(size, np.uint8)

    return cache.fetch(key, make, lambda array: (array,))


def test_a_value_is_made_once_while_it_is_held() -> None:
    cache, made = ArrayCache(1000), []
    assert fetch(cache, "a", made) is fetch(cache, "a", made)
    assert made == ["a"]


def test_the_least_recently_used_go_first_and_the_bound_holds() -> None:
    cache, made = ArrayCache(1000), []
    for key in range(10):
        fetch(cache, key, made)
    fetch(cache, 0, made)  # used again: 1 is the least recently used now
    fetch(cache, 10, made)
    fetch(cache, 0, made)
    assert made.count(0) == 1
    fetch(cache, 1, made)
    assert made.count(1) == 2
    for key in range(11, 200):
        fetch(cache, key, made)
        assert cache.held <= 1000
    fetch(cache, 199, made)
    assert made.count(199) == 1


def test_what_is_large_is_not_kept_and_evicts_nothing() -> None:
    cache, made = ArrayCache(1000), []
    fetch(cache, "small", made)
    fetch(cache, "4K", made, size=300)
    assert cache.held == 100


def test_putting_a_key_again_counts_its_bytes_once() -> None:
    cache = ArrayCache(1000)
    cache.put("a", np.zeros(100), 100)
    cache.put("a", np.zeros(200), 200)
    assert cache.held == 200
    cache.clear()
    assert cache.held == 0
