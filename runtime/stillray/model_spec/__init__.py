"""Model specifications: one TOML file a model and the strict loader."""

from stillray.model_spec.loader import ModelSpec, from_json, load, parse
from stillray.model_spec.rules import SpecError

__all__ = ["ModelSpec", "SpecError", "from_json", "load", "parse"]
