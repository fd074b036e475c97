"""What is kept, and what is forgotten first."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from rfpp.inference.bounded_cache import BoundedCache


def test_what_was_used_longest_ago_is_forgotten_first():
    cache = BoundedCache(max_bytes=10)
    for key in "ab":
        cache.put(key, key.upper(), 5)
    assert cache.get("a") == "A"
    cache.put("c", "C", 1)
    assert (cache.get("a"), cache.get("b"), cache.get("c")) == ("A", None, "C")
    assert (len(cache), cache.bytes) == (2, 6)


def test_what_is_too_large_is_not_kept_and_drives_nothing_out():
    cache = BoundedCache(max_bytes=10)
    cache.put("a", "A", 5)
    cache.put("b", "B", 11)
    assert (cache.get("a"), cache.get("b"), cache.bytes) == ("A", None, 5)


def test_a_value_replaces_the_one_before_it():
    cache = BoundedCache(max_bytes=10)
    cache.put("a", "A", 8)
    cache.put("a", "B", 9)
    assert (cache.get("a"), len(cache), cache.bytes) == ("B", 1, 9)


def test_what_is_there_is_not_made_again():
    cache, made = BoundedCache(max_bytes=10), []
    for _ in range(2):
        assert cache.recall("a", 5, lambda: made.append(1) or "A") == "A"
    assert made == [1]


def test_threads_that_want_the_same_wait_for_the_one_that_makes_it():
    cache, made, go_on = BoundedCache(max_bytes=10), [], threading.Event()

    def slowly():
        made.append(1)
        go_on.wait(10)
        return "A"

    with ThreadPoolExecutor(3) as pool:
        wanted = [pool.submit(cache.recall, "a", 5, slowly) for _ in range(3)]
        assert cache.recall("b", 5, lambda: "B") == "B", "others do not wait"
        go_on.set()
        assert [one.result(timeout=10) for one in wanted] == ["A"] * 3
    assert made == [1]


def test_what_could_not_be_made_is_tried_again():
    cache = BoundedCache(max_bytes=10)
    with pytest.raises(ZeroDivisionError):
        cache.recall("a", 5, lambda: 1 / 0)
    assert cache.recall("a", 5, lambda: "A") == "A"
