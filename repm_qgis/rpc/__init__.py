"""Rational polynomial camera models: the model itself, and the readers of vendors' formats."""

from .model import Rpc

__all__ = ["Rpc"]
