import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rfpp.inference.bounded_cache import BoundedCache, bytes_of
from rfpp.scene.mesh import Mesh


def test_the_least_recently_used_value_is_discarded_first():
    cache = BoundedCache(max_bytes=10)
    for key in "ab":
        cache.put(key, key.upper(), 5)
    assert cache.get("a") == "A"
    cache.put("c", "C", 1)
    assert (cache.get("a"), cache.get("b"), cache.get("c")) == ("A", None, "C")


def test_values_above_the_limit_are_not_stored():
    cache = BoundedCache(max_bytes=10)
    cache.put("a", "A", 5)
    cache.put("b", "B", 11)
    assert (cache.get("a"), cache.get("b")) == ("A", None)


def test_the_size_of_a_value_is_that_of_its_arrays():
    mesh = Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int64))
    expected = mesh.vertices.nbytes + mesh.faces.nbytes
    assert bytes_of((mesh, "name", (mesh, 1))) == 2 * expected
    cache = BoundedCache(max_bytes=expected)
    for key in "ab":
        cache.get_or_compute(key, None, lambda: mesh)
    assert (cache.get("a"), cache.get("b")) == (None, mesh)


def test_threads_wait_for_the_same_value_and_not_for_others():
    cache, made, go_on = BoundedCache(max_bytes=10), [], threading.Event()

    def slowly():
        made.append(1)
        go_on.wait(10)
        return "A"

    with ThreadPoolExecutor(3) as pool:
        wanted = [pool.submit(cache.get_or_compute, "a", 5, slowly) for _ in range(3)]
        assert cache.get_or_compute("b", 5, lambda: "B") == "B", "others do not wait"
        go_on.set()
        assert [one.result(timeout=10) for one in wanted] == ["A"] * 3
    assert made == [1]
