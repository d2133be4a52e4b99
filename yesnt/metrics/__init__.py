"""What pictures, materials and motion are measured by: arrays in, numbers out, each with its definition."""

from yesnt.metrics.definitions import DEFINITIONS, Definition, Metric, named

__all__ = ["DEFINITIONS", "Definition", "Metric", "named"]
