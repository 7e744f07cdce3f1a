"""The suite itself: what shares a costly fixture shares a worker, and what needs more than the repository carries is slow."""

import inspect

import conftest
import test_docs
import test_hostile_files


def test_what_shares_a_costly_fixture_shares_a_worker():
    for module, fixture in ((test_docs, "outcomes"), (test_hostile_files, "found")):
        tests = [n for n, f in vars(module).items() if n.startswith("test_") and inspect.isfunction(f)]
        sharing = {n for n in tests if fixture in inspect.signature(vars(module)[n]).parameters}
        scopes = {n: conftest.scope_of(f"tests/{module.__name__}.py::{n}[x]") for n in tests}
        assert len(sharing) > 0
        assert len({scopes[n] for n in sharing}) == 1
        assert all(scopes[n].endswith("[x]") for n in tests if n not in sharing), "and nothing else waits for it"


def test_what_needs_the_whole_data_is_slow(request):
    marked = {
        "shared_data" in getattr(item, "fixturenames", ()): item for item in request.session.items if not item.get_closest_marker("slow")
    }
    assert True not in marked, marked[True]
