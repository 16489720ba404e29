"""Recent results: made once for each key, shared, and never more of them than agreed."""

from meshes.base.cache import RecentResults


def test_a_result_is_made_once_and_the_one_asked_for_longest_ago_goes():
    kept, made = RecentResults(2), []

    def result(key):
        return kept.of(key, lambda: made.append(key) or [key])

    first = result("a")
    assert result("b") == ["b"] and result("a") is first and made == ["a", "b"]
    assert result("c") == ["c"] and result("a") is first and made == ["a", "b", "c"]
    assert result("b") == ["b"] and made == ["a", "b", "c", "b"]
    assert len(kept) == 2
