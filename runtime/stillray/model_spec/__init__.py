"""Model specifications: one TOML file a model and the strict loader."""

from stillray.model_spec.loader import ModelSpec, SpecError, from_json, load, parse

__all__ = ["ModelSpec", "SpecError", "from_json", "load", "parse"]
