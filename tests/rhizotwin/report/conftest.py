"""Scans without a renderer, as the tests of `recon` have them."""

from tests.recon.conftest import scan

__all__ = ["scan"]
