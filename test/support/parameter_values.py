"""Values that parameters take, for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from turbseg_ros.parameter_file import scalar
from turbseg_ros.parameters import Declaration, declarations

DECLARED = {declaration.name: declaration for declaration in declarations()}


def _whole(bound: float | None) -> int | None:
    return None if bound is None else int(bound)


def values_of(declaration: Declaration) -> st.SearchStrategy:
    """Any value that a parameter takes."""
    if declaration.choices:
        return st.sampled_from(declaration.choices)
    if declaration.type is bool:
        return st.booleans()
    if declaration.type is int:
        return st.integers(_whole(declaration.minimum), _whole(declaration.maximum))
    if declaration.type is float:
        # ROS takes smaller ones for texts.
        return st.floats(declaration.minimum, declaration.maximum, allow_subnormal=False)
    # Without quotes, where YAML libraries write none, ROS takes `y` and `1e5` for something else.
    return st.text().filter(lambda text: scalar(text) == text)


# Texts that are no choice among some.
FREE_TEXTS = (
    *("flow.weights", "refine.weights"),
    *("regions.file", "regions.ignore", "regions.include"),
)
MAPPINGS = st.fixed_dictionaries(
    {}, optional={name: values_of(declaration) for name, declaration in DECLARED.items()}
)
