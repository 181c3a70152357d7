"""Passes are counted for each reconstruction by itself."""

from contextvars import copy_context

from rhizotwin.recon import passes


def test_two_reconstructions_do_not_mix() -> None:
    def run(steps: int) -> dict[str, int]:
        passes.add("renderings")  # nobody counts yet, or another did
        passes.begin()
        for _ in range(steps):
            passes.add("gauss_newton_steps")
        return passes.get_counts()

    assert copy_context().run(run, 3) == {"gauss_newton_steps": 3, "renderings": 0, "carvings": 0}
    assert copy_context().run(run, 5)["gauss_newton_steps"] == 5
