from __future__ import annotations

import copy
import dataclasses
import json

import pytest

from stillray.model_spec import SpecError, from_json, load, parse
from stillray.model_spec.training import Training

_OPTIONAL = {
    field.name for field in dataclasses.fields(Training) if field.default is not dataclasses.MISSING
}


@pytest.fixture
def data():
    return json.loads(load("wskp-3s").to_json())


@pytest.mark.parametrize(
    "name",
    [
        "wskp-3",
        "wskp-3s",
        "wskp-6",
        "wskp-mr",
        "kpyr-5",
        "kpyr-5s",
        "nbg-2x1",
        "nbg-2x3",
        "nbg-7x3",
    ],
)
def test_spec_survives_the_metadata_of_a_model(name):
    spec = load(name)
    read = from_json(spec.to_json())
    assert read == spec
    assert read.differs == spec.differs


def test_unknown_key_is_named(data):
    data["decoder"]["kernal_sizes"] = [3]
    with pytest.raises(SpecError, match=r"unknown key decoder\.kernal_sizes"):
        parse(data)


def test_options_that_older_models_lack_may_be_missing(data):
    training = dataclasses.asdict(Training(**data["training"]))
    for key in _OPTIONAL:
        del training[key]
    spec = parse({**data, "training": training})
    assert spec.training.quiet_power == 0.0


def test_every_missing_key_is_named(data):
    for section, table in data.items():
        keys = [(section,)] if not isinstance(table, dict) else [(section, key) for key in table]
        for path in keys:
            if path[-1] in {
                *_OPTIONAL,
                "differs",
                "specular",
                "outlier_deviations",
                "most_blur",
                "sharp_contrast",
                "edge_blur",
            }:
                continue
            broken = copy.deepcopy(data)
            owner = broken
            for key in path[:-1]:
                owner = owner[key]
            del owner[path[-1]]
            with pytest.raises(SpecError, match="missing key " + r"\.".join(path)):
                parse(broken)


@pytest.mark.parametrize(
    ("section", "key", "value", "rule"),
    [
        ("network", "features", ["irradiance.r", "colour"], "network.features must be one of"),
        ("decoder", "kernel_sizes", [3, 4], "must be odd"),
        ("decoder", "logit_bound", 90.0, "decoder.logit_bound must be in"),
        ("demodulate", "floor", 0.0, "demodulate.floor must be in"),
        ("demodulate", "specular", 1.5, "demodulate.specular must be in"),
        ("training", "steps", "many", "training.steps must be of type int"),
        ("network", "branches", [5, 3], "network.branches"),
        ("network", "kernel_sizes", [5, 5], "network.kernel_sizes must have 3 entries for 2"),
    ],
)
def test_a_value_beyond_its_rule_is_named(data, section, key, value, rule):
    data[section][key] = value
    with pytest.raises(SpecError, match=rule):
        parse(data)


@pytest.mark.parametrize(
    ("contrast", "blur", "rule"),
    [
        (0.0, 0.5, r"temporal.edge_blur must be in \[0, 0\], got 0.5"),
        (4.0, -0.5, r"temporal.edge_blur must be in \[0, 1e"),
        (0.5, 0.0, r"temporal.sharp_contrast must be in \[1, 1e"),
    ],
)
def test_a_bound_beside_edges_needs_edges(data, contrast, blur, rule):
    data["temporal"] |= {"sharp_contrast": contrast, "edge_blur": blur}
    with pytest.raises(SpecError, match=rule):
        parse(data)


def test_no_rule_bounds_a_past_that_the_network_weighs():
    data = json.loads(load("munet-x1").to_json())
    data["temporal"]["edge_blur"] = 0.5
    with pytest.raises(SpecError, match=r"temporal.edge_blur must be in \[0, 0\], got 0.5"):
        parse(data)


def test_a_family_has_tables_of_its_own(data):
    data["family"] = "kernel-pyramid"
    with pytest.raises(SpecError, match=r"unknown key|missing key (network|decoder)\."):
        parse(data)
    data["family"] = "bilateral-gird"
    with pytest.raises(SpecError, match="family must be one of weight-sharing-kernels"):
        parse(data)


def test_a_pyramid_names_the_list_that_is_too_short():
    data = json.loads(load("kpyr-5").to_json())
    data["network"]["encoder_blocks"].pop()
    with pytest.raises(SpecError, match=r"network.encoder_blocks must have 5 entries"):
        parse(data)


def test_unknown_model_lists_those_there_are():
    with pytest.raises(
        SpecError,
        match=r"kpyr-5-still, kpyr-5s, kpyr-5s-albedo, .*munet-x1, .*, online-warm, wskp-3, .*got",
    ):
        load("wskp-7")


@pytest.mark.parametrize(
    ("table", "key", "value", "message"),
    [
        ("network", "guide_widths", [16, 32], "guide_widths must have 3 entries like radiance_"),
        ("network", "radiance_widths", [33, 96, 192], "radiance_widths must be even, got"),
        ("network", "radiance", [], "network.radiance must not be empty"),
        ("network", "guides", ["color.r"], "network.guides must be one of albedo.r"),
        ("decoder", "scale", 3, r"decoder.scale must be in \[1, 2\], got 3"),
        ("decoder", "features", 0, r"decoder.features must be in \[1, 32\], got 0"),
        ("decoder", "logit_bound", 30.0, r"decoder.logit_bound must be in"),
        ("training", "frames", 0, r"training.frames must be in"),
    ],
)
def test_an_upscaler_s_rules(table, key, value, message):
    data = json.loads(load("munet-x2").to_json())
    data[table][key] = value
    with pytest.raises(SpecError, match=message):
        parse(data)


def test_specs_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        load("wskp-3s").name = "x"


def test_a_multi_resolution_model_does_not_work_on_blocks():
    data = json.loads(load("wskp-mr").to_json())
    data["network"]["block"] = 2
    with pytest.raises(SpecError, match=r"network.block must be in \[1, 1\], got 2"):
        parse(data)


@pytest.mark.parametrize("distances", [[0], [4, 64], [-1]])
def test_albedo_is_averaged_over_distances_within_reach(distances):
    data = json.loads(load("kpyr-5").to_json())
    data["decoder"]["albedo_filters"] = distances
    with pytest.raises(SpecError, match=rf"decoder.albedo_filters .*got .*{distances[-1]}"):
        from_json(json.dumps(data))


@pytest.mark.parametrize(
    ("filters", "features", "message"),
    [
        ([4, 1], 0, r"decoder.filter_features must be in \[1, 32\], got 0"),
        ([4, 1], 33, r"decoder.filter_features must be in \[1, 32\], got 33"),
        ([], 6, r"decoder.filter_features must be in \[0, 0\], got 6"),
        ([4, 0], 6, r"decoder.finest_filters .*got .*0"),
        ([64], 6, r"decoder.finest_filters .*got .*64"),
    ],
)
def test_filters_and_their_features_belong_together(filters, features, message):
    data = json.loads(load("kpyr-5").to_json())
    data["decoder"] |= {"finest_filters": filters, "filter_features": features}
    with pytest.raises(SpecError, match=message):
        from_json(json.dumps(data))
