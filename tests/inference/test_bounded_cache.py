"""What is kept, and what is forgotten first."""

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
