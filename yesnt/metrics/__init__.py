"""Metrics of pictures, materials, videos and flow: arrays in, numbers out, each with its definition."""

from yesnt.metrics.definitions import DEFINITIONS, Definition, Metric, named

__all__ = ["DEFINITIONS", "Definition", "Metric", "named"]
