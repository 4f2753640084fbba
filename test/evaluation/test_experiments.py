"""What the ablation changes."""

from __future__ import annotations

from turbseg_ros.evaluation.experiments import VARIANTS
from turbseg_ros.parameters import Parameters, declarations


def test_each_variant_is_another_method_and_but_one_differs_from_the_default() -> None:
    made = {name: Parameters.from_mapping(changed) for name, changed in VARIANTS.items()}
    default = [name for name, parameters in made.items() if parameters == Parameters()]
    # All intervals are tried; one of them is the default.
    assert default == ["as configured", f"interval {Parameters().flow.interval}"]
    assert len(set(made.values())) == len(made) - 1


def test_no_variant_changes_what_has_no_effect() -> None:
    for changed in VARIANTS.values():
        idle = Parameters.from_mapping(changed).idle(replayed=True)
        assert not idle.keys() & changed.keys()


def test_every_part_that_a_parameter_turns_off_is_left_out_once() -> None:
    of_the_method = ("seed", "regions")
    switches = {
        declared.name
        for declared in declarations()
        if declared.type is bool and declared.name.partition(".")[0] in of_the_method
    }
    changed = [name for each in VARIANTS.values() for name in each]
    assert all(changed.count(name) == 1 for name in switches)


def test_the_variant_without_a_test_of_significance_allows_all_alarms_that_may_be() -> None:
    (limit,) = (
        declared.maximum
        for declared in declarations()
        if declared.name == "tracking.false_alarms_per_hour"
    )
    changed = VARIANTS["no test of significance"]
    assert changed == {"tracking.false_alarms_per_hour": limit}
