"""Constraints: their values, their composition, and what is said about mistakes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld import KeycldError
from keycld.mechanics import (
    AbstractRelation,
    Constraints,
    DistanceToPoint,
    FixedDistance,
    FunctionConstraint,
    OnLine,
    dump_constraints,
    load_constraints,
    mechanisms,
)
from keycld.mechanics.relation import relation_kinds
from keycld.mechanics.state import RESERVED

X = jnp.array([1.0, 2.0, 4.0, 6.0])


def test_values_and_order():
    constraints = Constraints(
        ("cart", "tip"),
        (OnLine("cart", (0.0, 2.0)), FixedDistance("cart", "tip"), DistanceToPoint("tip", (1.0, 2.0))),
    )
    # The normal of a line along +y points along −x.
    np.testing.assert_allclose(constraints(X), [-1.0, 25.0, 25.0], rtol=1e-6)
    assert (constraints.count, constraints.dimension) == (3, 4)


def test_sliding_along_the_line_changes_nothing():
    line = Constraints(("a",), (OnLine("a", (3.0, 4.0)),))
    x = jnp.array([0.3, -0.2])
    np.testing.assert_allclose(line(x + jnp.array([3.0, 4.0])), line(x), atol=1e-6)
    # The normal has unit length: Φ is a distance.
    np.testing.assert_allclose(line(x + jnp.array([-0.8, 0.6])) - line(x), [1.0], atol=1e-6)


def test_none_at_all():
    free = Constraints(("cart", "tip"))
    assert free.count == 0 and free(X).shape == (0,)


def test_pivot_of_each_trajectory():
    constraints = Constraints(("bob",), (DistanceToPoint("bob", "pivot"),))
    values = jax.vmap(lambda p: constraints(X[:2], {"pivot": p}))(jnp.array([[0.0, 0.0], [1.0, 0.0]]))
    np.testing.assert_allclose(values, [[5.0], [4.0]])
    with pytest.raises(KeycldError, match="'bob' turns around the parameter 'pivot'.*there: constants"):
        constraints(X[:2], {"constants": jnp.zeros(1)})


def test_functions_join_relations():
    def product(x, parameters):
        return x[0] * x[3]

    def both(x, parameters):
        return x[:2] ** 2

    constraints = Constraints(("cart", "tip"), (FixedDistance("cart", "tip"), product, both))
    np.testing.assert_allclose(constraints(X), [25.0, 6.0, 1.0, 4.0])
    assert constraints.count == 4
    nested = Constraints(("cart", "tip"), (constraints, OnLine("cart")))
    assert nested.count == 5


def test_function_that_reads_parameters():
    constraint = FunctionConstraint(lambda x, parameters: x @ parameters["normal"], 2)
    np.testing.assert_allclose(constraint(X[:2], {"normal": jnp.array([3.0, 4.0])}), [11.0])
    with pytest.raises(KeycldError, match="known only with the parameter 'normal'"):
        _ = constraint.count


def test_distances_have_the_same_directions():
    """Rows of DΦ differ in length only, so the motions are the same; v1's released code measures distances."""

    def product(x, parameters):
        return x[0] * x[3]

    squares = Constraints(
        ("cart", "tip"), (OnLine("cart"), FixedDistance("cart", "tip"), DistanceToPoint("tip", (1.0, 2.0)), product)
    )
    distances = squares.distances()
    np.testing.assert_allclose(distances(X), [2.0, 5.0, 5.0, 6.0], rtol=1e-6)
    one, other = jax.jacfwd(squares)(X), jax.jacfwd(distances)(X)
    np.testing.assert_allclose(one, np.array([1.0, 10.0, 10.0, 1.0])[:, None] * other, rtol=1e-6)
    assert distances.distances() == distances != squares
    assert Constraints(("cart", "tip"), (squares,)).distances() == distances


def test_joined_constraints_hold_for_their_keypoints_whatever_the_order():
    low = Constraints(("tip", "cart"), (OnLine("tip"),))
    joined = Constraints(("cart", "tip"), (OnLine("cart"), low))
    assert joined == Constraints(("cart", "tip"), (OnLine("cart"), OnLine("tip")))
    np.testing.assert_allclose(joined(X), [X[1], X[3]])


def test_derivatives_of_a_distance_exist_where_the_points_meet():
    distance = Constraints(("a", "b"), (FixedDistance("a", "b"), OnLine("a"))).distances()
    together = jnp.array([0.3, 0.4, 0.3, 0.4])
    assert np.isfinite(jax.jacfwd(distance)(together)).all()
    assert np.isfinite(jax.jacfwd(jax.jacrev(distance))(together)).all()


def test_distances_are_not_written():
    with pytest.raises(KeycldError, match="measured by distances cannot be written"):
        dump_constraints(Constraints(("a",), (DistanceToPoint("a"),)).distances())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Constraints(("cart", "tip"), (OnLine("card"),)), "unknown keypoint 'card': did you mean 'cart'"),
        (lambda: Constraints(()), "at least one keypoint"),
        (lambda: Constraints("cart"), "not the one text"),
        (lambda: Constraints(("cart", " ")), "not empty"),
        (lambda: Constraints(("cart", "cart")), "'cart' is named twice"),
        (lambda: FixedDistance("cart", "cart"), "two different keypoints"),
        (lambda: OnLine("cart", (0, 0)), r"direction \(0, 0\)"),
        (lambda: OnLine("cart", (1, 2, 3)), "two finite numbers"),
        (lambda: OnLine("cart", (1, float("nan"))), "two finite numbers"),
        (lambda: DistanceToPoint("tip", 3), "two finite numbers"),
        (lambda: DistanceToPoint("tip", ""), "empty"),
        *((lambda name=name: DistanceToPoint("tip", name), f"cannot be the parameter '{name}'") for name in RESERVED),
        (lambda: Constraints(("a",), (7,)), "'int' is no constraint"),
        (lambda: Constraints(("a",), (Constraints(("a", "b")),)), "unknown keypoint 'b'"),
        (
            lambda: Constraints(("a", "b"), (Constraints(("b", "a"), (lambda x, _: x[:1],)),)),
            "a function of the keypoints b, a cannot join those of a, b",
        ),
        (
            lambda: Constraints(("a", "b"), (Constraints(("a", "b"), (FixedDistance("a", "b"),)).distances(),)),
            "by squares and by distances cannot be joined",
        ),
        (lambda: FunctionConstraint(lambda x, _: jnp.outer(x, x), 2)(X[:2]), r"float32 of shape \(2, 2\)"),
    ],
)
def test_mistakes(make, message):
    with pytest.raises(KeycldError, match=message):
        make()


ALL = Constraints(
    ("cart", 'a "quoted"\ttip', "Δ"),
    (
        OnLine("cart", (1.0, 0.5)),
        FixedDistance("cart", "Δ"),
        DistanceToPoint('a "quoted"\ttip', (0.25, -1e-3)),
        DistanceToPoint("Δ", "pivot"),
    ),
)


@pytest.mark.parametrize("constraints", [ALL, Constraints(("a", "b"))])
def test_toml_round_trip(tmp_path, constraints):
    path = tmp_path / "constraints.toml"
    path.write_text(dump_constraints(constraints), encoding="utf-8")
    read = load_constraints(path)
    assert read == constraints


def test_functions_have_no_toml():
    with pytest.raises(KeycldError, match="FunctionConstraint cannot be written"):
        dump_constraints(Constraints(("a",), (lambda x, _: x[0],)))


MIDPOINT = '''
"""A relation in a file of its own."""

import equinox as eqx
import jax.numpy as jnp

from keycld.mechanics import AbstractRelation, register_relation


@register_relation
class MidpointHeight(AbstractRelation):
    """The middle of two keypoints stays at one height: a beam on a knife edge."""

    kind = "midpoint_height"
    required = ("between",)
    optional = ("weight", "mirrored")

    ends: tuple[str, str] = eqx.field(static=True)
    weight: float = eqx.field(static=True, default=0.5)
    mirrored: bool = eqx.field(static=True, default=False)

    @property
    def keypoints(self):
        return self.ends

    def __call__(self, points, parameters):
        return (1 - self.weight) * points[0, 1] + self.weight * points[1, 1]

    @classmethod
    def read(cls, entries):
        return cls(tuple(entries["between"]), entries.get("weight", 0.5), entries.get("mirrored", False))

    def write(self):
        return {"between": self.ends, "weight": self.weight, "mirrored": self.mirrored}
'''


def test_a_kind_of_constraint_is_one_file(tmp_path, monkeypatch):
    """In Python, as TOML and back, next to the others and in any order of keypoints."""
    (tmp_path / "knife_edge.py").write_text(MIDPOINT)
    monkeypatch.syspath_prepend(tmp_path)
    from knife_edge import MidpointHeight  # pyright: ignore[reportMissingImports]

    constraints = Constraints(("cart", "tip"), (OnLine("cart"), MidpointHeight(("tip", "cart"), 0.25)))
    np.testing.assert_allclose(constraints(X), [2.0, 0.75 * 6.0 + 0.25 * 2.0])
    assert constraints.count == 2
    path = tmp_path / "constraints.toml"
    path.write_text(dump_constraints(constraints))
    assert load_constraints(path) == constraints
    path.write_text(HEAD + "[[constraint]]\nkind = 'midpoint_height'\nbetween = ['cart', 'tap']")
    with pytest.raises(KeycldError, match="constraint 1: unknown keypoint 'tap': did you mean 'tip'"):
        load_constraints(path)
    path.write_text(HEAD + "[[constraint]]\nkind = 'midpoint_height'\nbetween = 3")
    with pytest.raises(
        KeycldError, match=r"constraint 1: MidpointHeight.read cannot read .*midpoint_height .*TypeError"
    ):
        load_constraints(path)


def test_every_file_of_the_folder_is_a_kind():
    assert {"fixed_distance", "distance_to_point", "on_line"} <= set(relation_kinds())


def test_a_relation_that_is_not_registered_has_no_toml():
    class Height(AbstractRelation):
        kind = "on_line"
        required = ("keypoint",)
        keypoint: str = eqx.field(static=True)

        @property
        def keypoints(self):
            return (self.keypoint,)

        def __call__(self, points, parameters):
            return points[0, 1]

        @classmethod
        def read(cls, entries):
            return cls(**entries)

        def write(self):
            return {"keypoint": self.keypoint}

    with pytest.raises(KeycldError, match="a Height cannot be written as TOML"):
        dump_constraints(Constraints(("a",), (Height("a"),)))


HEAD = 'keypoints = ["cart", "tip"]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs the names of the keypoints"),
        ("keypoints = [", "not valid TOML"),
        ('keypoints = ["a"]\nlength = 3', "unknown entry 'length'"),
        ('keypoints = ["a"]\nconstraint = 3', r"begin each with \[\[constraint\]\]"),
        (HEAD + "[[constraint]]\nkeypoint = 'cart'", "constraint 1: it needs a kind"),
        (HEAD + "[[constraint]]\nkind = 'on_lines'", "constraint 1: unknown kind .* did you mean 'on_line'"),
        (HEAD + "[[constraint]]\nkind = 'on_line'\nkeypoint = 'carf'", "constraint 1: .*did you mean 'cart'"),
        (HEAD + "[[constraint]]\nkind = 'on_line'", "constraint 1: .* needs the entry 'keypoint'"),
        (HEAD + "[[constraint]]\nkind = 'on_line'\nkeypoint = 3", "constraint 1: 'keypoint' is a name"),
        (HEAD + "[[constraint]]\nkind = 'on_line'\nkeypoint = 'cart'\npoint = 1", "unknown entry .point. of a on_line"),
        (
            HEAD
            + "[[constraint]]\nkind = 'on_line'\nkeypoint = 'cart'\n"
            + "[[constraint]]\nkind = 'fixed_distance'\nbetween = ['cart']",
            "constraint 2: 'between' is two keypoints",
        ),
    ],
)
def test_toml_mistakes_name_file_entry_and_fix(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(KeycldError, match=f"mine.toml.*{message}"):
        load_constraints(path)


def test_toml_files_that_cannot_be_read(tmp_path):
    with pytest.raises(KeycldError, match="there is no constraints file"):
        load_constraints(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(KeycldError, match="is not UTF-8 text"):
        load_constraints(tmp_path / "binary.toml")
    with pytest.raises(KeycldError, match="cannot read"):
        load_constraints(tmp_path)


def test_mechanisms_have_names():
    assert {"pendulum", "double-pendulum", "cart-pole", "spring"} <= set(mechanisms())
    for name in mechanisms():
        constraints = load_constraints(name)
        assert constraints.unknowns and 2 * len(constraints.keypoints) > constraints.count
    with pytest.raises(KeycldError, match="unknown mechanism or constraints file '': choose from .*pendulum"):
        load_constraints("")
    with pytest.raises(KeycldError, match="unknown mechanism or constraints file 'pendulun': did you mean 'pendulum'"):
        load_constraints("pendulun")


def test_a_file_comes_before_a_mechanism_of_the_same_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spring").write_text('keypoints = ["mine"]')
    assert load_constraints("spring").keypoints == ("mine",)
