"""Every error at generation names the thing and the remedy."""

import re
import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg

Q2, P2, G2 = ca.DM.eye(2), ca.DM.zeros(2), ca.DM.eye(2)
q, u, tau, t = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2), ca.SX.sym("t")
par = sg.Parameters(a=1.0, k=[1.0, 2.0], zero=0.0)


def mechanism(**changes: Any) -> sg.Mechanism:
    return sg.Mechanism(**({"q": q, "u": u, "tau": tau, "Q": Q2, "P": P2, "G": G2} | changes))


def speed(psi: Any = None, Theta: Any = -1.0, name: str = "speed") -> sg.Nonholonomic:
    return sg.Nonholonomic(name, u[0] + q[1] if psi is None else psi, Theta)


def scene(constraints: Any = None, mech: sg.Mechanism | None = None, **more: Any) -> sg.Scene:
    name = more.pop("name", "test")
    return sg.Scene(name, mech or mechanism(), [speed()] if constraints is None else constraints, **more)


def built(*args: Any, **more: Any) -> sg.Package:
    scalar = more.pop("scalar", "float64")
    return sg.build(scene(*args, **more), scalar=scalar)


def refused(make: Callable[[], Any], *words: str) -> str:
    """The message of the SceneError that `make` raises; it holds all the words."""
    with pytest.raises(sg.SceneError) as error:
        make()
    message = str(error.value)
    for word in words:
        assert word in message, message
    assert "\n" not in message
    return message


def test_scene_error_is_a_value_error() -> None:
    assert issubclass(sg.SceneError, ValueError)


# ---- shapes ----


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"Q": ca.DM.eye(3)}, ("Q has shape 3x3", "2x2")),
        ({"Q": [[1.0, 0.0]]}, ("Q has shape 1x2", "2x2")),
        ({"P": [0.0, 0.0, 0.0]}, ("P has shape 3x1", "column of 2")),
        ({"G": ca.DM.ones(2, 3)}, ("G has shape 2x3", "2x2", "one column per control")),
        ({"C": ca.DM.eye(3)}, ("C has shape 3x3", "2x2")),
        ({"D": [1.0]}, ("D has shape 1x1", "column of 2")),
        ({"t": ca.SX.sym("t", 2)}, ("t has 2 entries", "one SX symbol")),
        ({"q": ca.SX.sym("q", 3)}, ("q has 3 entries and u has 2", "give C (3x2)")),
        ({"q": ca.SX.sym("q", 2, 2)}, ("q has shape 2x2", "column")),
        ({"u": ca.SX(0, 1)}, ("u is empty", "at least one symbol")),
        ({"u": u * 2}, ("u must consist of SX symbols only",)),
        ({"u": ca.vertcat(u[0], u[0])}, ("u holds a symbol twice",)),
        ({"tau": [1, 2]}, ("tau must be SX symbols", "ca.SX.sym('tau', n)", "list")),
        ({"q": ca.MX.sym("q", 2)}, ("q must be SX symbols, not MX; use SX", "ca.SX.sym", "f.expand()")),
        ({"P": ca.MX.sym("p", 2)}, ("P is CasADi MX; use SX", "ca.SX.sym", "f.expand()")),
        ({"P": [u[0], u[1]]}, ("P is a list of SX", "ca.vertcat")),
        ({"Q": np.array([[u[0] * 0 + 1, 0], [0, q[0]]], dtype=object)}, ("Q is a ndarray of SX", "ca.horzcat")),
        ({"P": "gravity"}, ("P: cannot read str",)),
        ({"P": "1"}, ("P: cannot read str",)),
        ({"P": ca.Function("f", [q], [q])}, ("P is a CasADi Function", "call it")),
        ({"q": [ca.SX.sym("a"), ca.SX.sym("b")]}, ("q is a list of SX", "ca.vertcat")),
        ({"G": None}, ("G is None",)),
    ],
)  # fmt: skip
def test_mechanism_shapes_and_kinds(changes: dict[str, Any], words: tuple[str, ...]) -> None:
    refused(lambda: mechanism(**changes), *words)


def test_row_vectors_are_turned() -> None:
    assert mechanism(P=ca.DM([[1.0, 2.0]])).P.shape == (2, 1)
    assert sg.Nonholonomic("row", u.T, -1.0).psi.shape == (2, 1)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sg.Nonholonomic("task", ca.SX(2, 2), -1.0), ("constraint 'task': psi has shape 2x2", "column")),
        (lambda: sg.Nonholonomic("task", ca.SX(0, 1), -1.0), ("constraint 'task': psi is empty",)),
        (lambda: sg.Nonholonomic("task", u, [-1.0] * 3), ("'task': Theta has shape 3x1", "vector of 2", "2x2")),
        (lambda: sg.Nonholonomic("task", u, -np.eye(3)), ("constraint 'task': Theta has shape 3x3",)),
        (lambda: sg.Holonomic("path", q, [-1.0] * 3, -1.0), ("constraint 'path': Theta1 has shape 3x1",)),
        (lambda: sg.Holonomic("path", q, -1.0, -np.eye(3)), ("constraint 'path': Theta2 has shape 3x3",)),
        (lambda: sg.ControlsInvolved("law", tau, -np.eye(3)), ("constraint 'law': Theta has shape 3x3",)),
        (lambda: sg.Nonholonomic("", u, -1.0), ("name must be printable text",)),
        (lambda: sg.Nonholonomic("a\nb", u, -1.0), ("name must be printable text",)),
        (lambda: sg.Nonholonomic(3, u, -1.0), ("name must be printable text",)),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_constraint_shapes(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    refused(make, *words)


def test_theta_shapes_that_are_right() -> None:
    for Theta in (-1.0, -1, np.float32(-1), [-1.0, -2.0], np.array([[-1.0, -2.0]]), [[-1.0, 1.0], [0.0, -2.0]], -Q2):
        assert sg.Nonholonomic("task", u, Theta).Theta.shape == (2, 2)
    assert ca.DM(sg.Nonholonomic("task", u, [-1.0, -2.0]).Theta).full().tolist() == [[-1.0, 0.0], [0.0, -2.0]]


# ---- the scene as a whole ----


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: scene([]), ("scene 'test' has no constraints", "at least one")),
        (lambda: scene(3), ("scene 'test'", "constraints must be a list", "int")),
        (lambda: scene([u[0]]), ("SX is no servo-constraint", "sg.Nonholonomic")),
        (lambda: sg.Scene("test", "robot", [speed()]), ("sg.Mechanism", "str")),  # type: ignore[arg-type]
        (lambda: scene(parameters={"a": 1.0}), ("parameters must be sg.Parameters", "dict")),
        (lambda: scene(references=[1.0]), ("references must be sg.References", "list")),
        (lambda: scene([speed(name="one"), speed(u[1], name="one")]), ("two constraints named 'one'", "rename")),
        (lambda: scene(y="inputs"), ("y='inputs'", "'input'")),
        (lambda: scene(y=u[0]), ("y has shape 1x1", "column of 2")),
        (lambda: scene(mode="best"), ("mode='best'",)),
        (lambda: sg.build(scene(), scalar="float16"), ("scalar 'float16'", "float64", "float32")),  # type: ignore[arg-type]
        (lambda: sg.build(scene(), prefix="1st"), ("prefix '1st' is not a C identifier",)),
    ],
)
def test_scene_as_a_whole(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    refused(make, *words)


def test_one_constraint_needs_no_list() -> None:
    assert scene(speed()).rows == 1


def test_mixed_kinds() -> None:
    law = sg.ControlsInvolved("law", tau[0] + u[0])
    refused(lambda: scene([speed(), law]), "mixes controls-involved", "'law'", "'speed'", "two scenes")


def test_tau_missing_from_phi() -> None:
    law = sg.ControlsInvolved("law", u[0] + q[0])
    refused(lambda: scene([law]), "constraint 'law'", "tau is missing from phi", "sg.Nonholonomic")


def test_psi_depends_on_tau() -> None:
    refused(lambda: scene([speed(u[0] + tau[1])]), "constraint 'speed'", "psi depends on tau", "sg.ControlsInvolved")
    path = sg.Holonomic("path", q[0] * tau[0], -2.0, -1.0)
    refused(lambda: scene([path]), "constraint 'path'", "psi depends on tau", "sg.ControlsInvolved")


def test_holonomic_psi_depends_on_u() -> None:
    path = sg.Holonomic("path", q[0] + u[0], -2.0, -1.0)
    refused(lambda: scene([path]), "constraint 'path'", "depends on u", "sg.Nonholonomic")


@pytest.mark.parametrize("name", ["Q", "P", "G", "C", "D"])
def test_tau_in_the_mechanism(name: str) -> None:
    value = {"Q": ca.diag(1 + tau**2), "P": tau, "G": ca.diag(tau), "C": ca.diag(tau), "D": tau}[name]
    refused(lambda: mechanism(**{name: value}), f"{name} depends on tau", "G tau only")


@pytest.mark.parametrize("name", ["Q", "C", "D"])
def test_u_where_only_q_and_t_may_stand(name: str) -> None:
    value = {"Q": ca.diag(1 + u**2), "C": ca.diag(u), "D": u}[name]
    refused(lambda: mechanism(**{name: value}), f"{name} depends on u", "q and t only")


def test_tau_in_y() -> None:
    refused(lambda: scene(y=-tau), "y depends on tau", "function of the inputs")
    law = sg.ControlsInvolved("law", tau[0] + u[0])
    assert scene([law], y=-tau).kind == "controls"


# ---- symbols ----


@pytest.mark.parametrize(
    ("where", "make"),
    [
        ("constraint 'speed': psi", lambda x: scene([speed(u[0] * x)])),
        ("constraint 'path': psi", lambda x: scene([sg.Holonomic("path", q[0] * x, -2.0, -1.0)])),
        ("constraint 'law': phi", lambda x: scene([sg.ControlsInvolved("law", tau[0] * x)])),
        ("Q", lambda x: scene(mech=mechanism(Q=ca.diag(ca.vertcat(1 + x**2, 1))))),
        ("P", lambda x: scene(mech=mechanism(P=ca.vertcat(x, 0)))),
        ("G", lambda x: scene(mech=mechanism(G=ca.diag(ca.vertcat(1 + x**2, 1))))),
        ("C", lambda x: scene(mech=mechanism(C=ca.diag(ca.vertcat(x, 1))))),
        ("D", lambda x: scene(mech=mechanism(D=ca.vertcat(x, 1)))),
        ("y", lambda x: scene(y=ca.vertcat(x, 0))),
    ],
)
def test_a_symbol_that_is_no_input(where: str, make: Callable[[Any], Any]) -> None:
    message = refused(lambda: make(ca.SX.sym("mystery")), where, "'mystery'", "not an input of scene 'test'")
    assert message.startswith(where)
    assert "parameters or the references" in message


def test_a_symbol_of_the_same_name_is_another_symbol() -> None:
    refused(lambda: scene([speed(ca.SX.sym("u", 2)[0])]), "'u_0'", "not an input")


def test_time_without_t_is_no_input() -> None:
    refused(lambda: scene([speed(u[0] - ca.sin(t))]), "'t'", "not an input")
    assert scene([speed(u[0] - ca.sin(t))], mech=mechanism(t=t)).rows == 1


def test_a_symbol_with_two_roles() -> None:
    refused(lambda: scene(mech=mechanism(u=q)), "stands in both q and u")
    refused(lambda: scene(mech=mechanism(tau=par.k), parameters=par), "stands in both tau and parameter 'k'")


def test_theta_of_something_but_parameters() -> None:
    refused(lambda: scene([speed(Theta=-1 - q[0] ** 2)]), "constraint 'speed': Theta holds 'q_0'", "not a parameter")
    path = sg.Holonomic("path", q[0], -2.0, -1 - t**2)
    refused(lambda: scene([path], mech=mechanism(t=t)), "constraint 'path': Theta2 holds 't'", "sg.Parameters")


# ---- operations ----


@pytest.mark.parametrize(
    ("where", "make"),
    [
        ("constraint 'speed': psi", lambda f: scene([speed(), speed(u[0] + f(q[0]))][1:])),
        ("constraint 'law': phi", lambda f: scene([sg.ControlsInvolved("law", tau[0] + f(u[0]))])),
        ("Q", lambda f: scene(mech=mechanism(Q=ca.diag(2 + f(q))))),
        ("P", lambda f: scene(mech=mechanism(P=f(q)))),
        ("y", lambda f: scene(y=f(q))),
    ],
)
def test_an_unsupported_operation(where: str, make: Callable[[Any], Any]) -> None:
    message = refused(lambda: make(ca.erfinv), f"{where}: operation erfinv (CasADi id {ca.OP_ERFINV})", "not supp")
    assert "ir/ops.py" in message


# ---- stability ----


def test_unstable_theta_number() -> None:
    refused(lambda: speed(Theta=1.0), "constraint 'speed': Theta is unstable", "real part 1,", "grow", "Hurwitz")
    refused(lambda: speed(Theta=0), "constraint 'speed': Theta is marginal", "real part 0,", "not decay", "Hurwitz")


def test_unstable_theta_vector() -> None:
    refused(lambda: sg.Nonholonomic("task", u, [-1.0, 0.5]), "constraint 'task': Theta is unstable", "0.5")


@pytest.mark.parametrize(
    ("Theta", "told"),
    [
        ([[-1, 2], [2, -1]], "unstable: it has an eigenvalue with real part 1,"),
        ([[1e-20, 1], [-1, 0]], "unstable: it has an eigenvalue with real part 5e-21,"),
        ([[0, 1], [-1, 0]], "marginal: it has an eigenvalue with real part 0,"),
        ([[1, -2], [1, -1]], "marginal: it has an eigenvalue with real part 0,"),
        ([[-1, 1], [1, -1]], "marginal: it has an eigenvalue with real part 0,"),
        ([[-0.1, -0.3], [-0.3, -0.9]], "marginal: it has an eigenvalue with real part 0,"),
    ],
)
def test_unstable_theta_matrix(Theta: Any, told: str) -> None:
    refused(lambda: sg.Nonholonomic("task", u, Theta), f"constraint 'task': Theta is {told}", "Hurwitz")


def test_stable_theta_matrix() -> None:
    sg.Nonholonomic("task", u, [[-1, 100], [0, -1e-6]])
    sg.Nonholonomic("task", u, [[0, 1], [-1, -1e-9]])


def test_singular_theta_is_refused_whatever_side_of_zero_rounding_puts_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):  # integers: the product is exactly singular
        half = rng.integers(-9, 10, (4, 2)).astype(float)
        refused(
            lambda half=half: sg.Nonholonomic("task", ca.SX.sym("u", 4), -half @ half.T), "marginal", "real part 0,"
        )


def test_theta_that_is_hurwitz_by_its_eigenvalues_is_accepted() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 3, 5, 8):
        for _ in range(20):
            Theta = rng.normal(size=(n, n))
            worst = float(np.max(np.linalg.eigvals(Theta).real))
            sg.Nonholonomic("task", ca.SX.sym("u", n), Theta - (worst + 1e-3) * np.eye(n))
            shifted = Theta - (worst - 1e-3) * np.eye(n)
            refused(lambda n=n, shifted=shifted: sg.Nonholonomic("task", ca.SX.sym("u", n), shifted), "unstable")


def test_companion_must_be_hurwitz_though_each_block_is() -> None:
    Theta1, Theta2 = [[-1.0, 0.0], [0.0, -1.0]], [[-1.0, 4.0], [-4.0, -1.0]]
    for block in (Theta1, Theta2):
        assert np.all(np.linalg.eigvals(block).real < 0)
    refused(
        lambda: sg.Holonomic("path", q, Theta1, Theta2),
        "constraint 'path'", "companion [[0, I], [Theta2, Theta1]]", "unstable", "real part 0.7884,",
    )  # fmt: skip
    for Theta1, Theta2 in ((-1.0, 0.0), (-1.0, [[-1.0, -1.0], [-1.0, -1.0]]), (0.0, -1.0)):
        refused(
            lambda one=Theta1, two=Theta2: sg.Holonomic("path", q, one, two), "companion", "marginal", "real part 0,"
        )
    sg.Holonomic("path", q, [-3.0, -4.0], [[-1.0, 0.5], [0.5, -1.0]])


def test_controls_involved_theta_may_be_zero() -> None:
    for Theta in (0, 0.0, [0.0, 0.0], np.zeros((2, 2))):
        assert sg.ControlsInvolved("law", tau, Theta).Theta.is_zero()
    assert sg.ControlsInvolved("law", tau).Theta.is_zero()
    refused(lambda: sg.ControlsInvolved("law", tau, 0.1), "constraint 'law': Theta", "unstable", "0 would be allowed")
    refused(lambda: sg.ControlsInvolved("law", tau, [0.0, -1.0]), "constraint 'law': Theta", "marginal")


# ---- numbers that are not finite ----


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mechanism(P=np.array([np.nan, 0.0])), ("P has an entry nan", "finite")),
        (lambda: mechanism(Q=ca.DM([[1, 0], [0, ca.inf]])), ("Q has an entry inf", "finite")),
        (lambda: mechanism(G=np.array([[1.0, 0], [0, -np.inf]])), ("G has an entry -inf", "finite")),
        (lambda: speed(Theta=float("nan")), ("constraint 'speed': Theta has an entry nan",)),
        (lambda: speed(Theta=None), ("constraint 'speed': Theta is None",)),
        (lambda: speed(ca.vertcat(u[0], ca.inf)), ("constraint 'speed': psi has an entry inf",)),
        (lambda: scene([speed(u[0] + ca.SX(ca.inf) * q[0])]), ("'speed': psi holds the constant inf", "finite")),
        (lambda: scene(mech=mechanism(P=ca.vertcat(q[0] + float("nan"), 0))), ("P", "nan", "finite")),
        (lambda: scene(y=[0.0, np.nan]), ("y has an entry nan",)),
        (lambda: sg.Parameters(a=float("inf")), ("parameter 'a'", "inf", "not finite")),
        (lambda: sg.Parameters(a=[1.0, float("nan")]), ("parameter 'a'", "not finite")),
        (lambda: sg.Parameters(a=sg.Parameter(float("nan"), "m")), ("parameter 'a'", "not finite")),
        (lambda: sg.References(r=sg.Ref([0.0, float("inf")], order=1)), ("reference 'r'", "not finite")),
        (lambda: sg.Solver(rtol=float("nan")), ("rtol=nan",)),
        (lambda: sg.Solver(atol=[1.0, float("inf")]), ("atol=",)),
        (lambda: sg.Solver(damping=float("inf")), ("damping=inf",)),
        (lambda: scene(domain={"q": (0.0, float("inf"))}), ("domain['q']", "finite")),
    ],
)  # fmt: skip
def test_numbers_that_are_not_finite(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    refused(make, *words)


def test_constants_that_do_not_fit_the_type() -> None:
    small = [speed(u[0] + 1e-60 * q[0])]
    assert built(small).manifest["scalar"] == "float64"
    refused(lambda: built(small, scalar="float32"), "1e-60", "vanishes in float32", "rescale")
    refused(lambda: built([speed(u[0] + 1e60 * q[0])], scalar="float32"), "1e+60", "too large for float32")


# ---- parameters, references, domain, solver ----


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sg.Parameters(a="heavy"), ("parameter 'a'", "'heavy'", "neither a number nor a list")),
        (lambda: sg.Parameters(a=[]), ("parameter 'a'", "empty")),
        (lambda: sg.Parameters(a=[[1.0, 2.0], [3.0, 4.0]]), ("parameter 'a'", "(2, 2)", "column")),
        (lambda: sg.References(r=sg.Ref(0.0, order=1.5)), ("sg.Ref(order=1.5)", "give 0, 1, 2, ...")),
        (lambda: sg.References(r=sg.Ref(0.0, order=3), r_d3=0.0), ("r_d3", "collides", "rename")),
        (lambda: sg.References(r=sg.Ref(0.0, order=1), r_dot=0.0), ("r_dot", "collides", "rename")),
        (lambda: sg.References(r_dot=0.0, r=sg.Ref(0.0, order=1)), ("r_dot", "collides", "rename")),
        (lambda: scene(parameters=par, references=sg.References(a=0.0)), ("parameter 'a'", "collides with the ref")),
        (lambda: sg.Solver(method="qr"), ("method='qr'", "'auto', 'svd' or 'cod'")),  # type: ignore[arg-type]
        (lambda: sg.Solver(method="cod", damping=0.1), ("method='cod'", "damping=0.1", "singular values")),
        (lambda: sg.Solver(method="cod", sigma_min="exact"), ("method='cod'", "iteration", "'bound'")),
        (lambda: sg.Solver(rank="full"), ("rank='full'",)),  # type: ignore[arg-type]
        (lambda: sg.Solver(rtol=1.0), ("rtol=1.0",)),
        (lambda: sg.Solver(damping=0.0), ("damping=0.0", "None")),
        (lambda: built(solver=sg.Solver(atol=[0.0, 0.0])), ("atol", "2 numbers", "1 rows")),
        (lambda: scene(domain={"x": (0, 1)}), ("domain: 'x' is no input", "q, u")),
        (lambda: scene(domain={"q": (1, 0)}), ("domain['q']", "lo <= hi")),
        (lambda: scene(domain={"q": ([0, 0, 0], 1)}), ("domain['q']", "list of 2")),
        (lambda: scene(domain={"q": 3}), ("domain['q']", "(lo, hi)")),
        (lambda: scene(domain=[0, 1]), ("domain is a list", "(lo, hi)")),
        (lambda: built(domain=lambda rng: {"q": [0.0]}), ("domain", "'q'", "1 entries", "must have 2")),
        (lambda: built(domain=lambda rng: {"speed": [0.0]}), ("domain", "'speed'", "no input")),
    ],
)  # fmt: skip
def test_parameters_references_domain_and_solver(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    refused(make, *words)


def test_an_attribute_that_is_no_parameter() -> None:
    with pytest.raises(AttributeError, match="no parameter 'mass'; there are a, k, zero"):
        _ = par.mass
    with pytest.raises(AttributeError, match="no reference 'x'; there are none"):
        _ = sg.References().x


def test_references_of_too_low_order() -> None:
    ref = sg.References(r=sg.Ref(0.0, order=1), s=sg.Ref(0.0, order=2))
    path = sg.Holonomic("path", q[0] - ref.r, -2.0, -1.0)
    refused(
        lambda: built([path], references=ref),
        "constraint 'path' needs the derivative of 'r_dot'", "reference 'r'", "order=2",
    )  # fmt: skip
    refused(
        lambda: built([speed(u[0] - ref.r_dot)], references=ref), "'speed' needs the derivative of 'r_dot'", "order=2"
    )
    refused(lambda: built([speed(u[0] - ref.s_ddot)], references=ref), "derivative of 's_ddot'", "order=3")
    law = sg.ControlsInvolved("law", tau[0] - ref.r_dot)
    refused(lambda: built([law], references=ref), "'law' needs the derivative of 'r_dot'")
    assert built([sg.Holonomic("path", q[0] - ref.s, -2.0, -1.0)], references=ref).path.is_dir()
    assert built([speed(u[0] - ref.r)], references=ref).path.is_dir()


def test_a_plain_reference_has_rate_zero() -> None:
    ref = sg.References(r=0.5)
    path = sg.Holonomic("path", q[0] * q[0] - ref.r, -2.0, -1.0)
    controller = sg.reference(scene([path], references=ref))
    assert controller.z(q=[0.5, 0.0], u=[0.3, 0.0]) == pytest.approx([-2 * 0.3 - 2 * 0.3**2 + 0.25])


# ---- what derivation finds ----


def test_structurally_singular_mass() -> None:
    zero_row = mechanism(Q=ca.diag(ca.vertcat(1 + q[0] ** 2, 0)))
    refused(lambda: built(mech=zero_row), "Q is structurally singular", "rank is below 2", "inertia")


def test_dense_mass_that_is_singular_everywhere() -> None:
    a = 1 + q[0] ** 2
    for b in (a, ca.sin(q[1]) + 3):
        dense = ca.vertcat(ca.horzcat(a * a, a * b), ca.horzcat(b * a, b * b))
        refused(lambda dense=dense: built(mech=mechanism(Q=dense)), "Q is structurally singular", "rank is below 2")


def test_constant_singular_mass() -> None:
    refused(lambda: built(mech=mechanism(Q=[[1.0, 2.0], [2.0, 4.0]])), "Q is structurally singular")


def test_mass_in_awkward_units_is_not_singular() -> None:
    assert built(mech=mechanism(Q=ca.diag(ca.vertcat(1e-9, 1e9)))).path.is_dir()
    assert built(mech=mechanism(Q=[[1e-8, 1e-3], [1e-3, 1e6]])).path.is_dir()


def test_mass_that_is_nowhere_finite() -> None:
    bad = mechanism(Q=ca.diag(ca.vertcat(ca.sqrt(-1 - q[0] ** 2), 1)))
    refused(lambda: built(mech=bad), "Q is not finite at any state", "domain")


def spring_coupled() -> tuple[sg.Mechanism, Any, Any]:
    """A mass driven through a spring by another: the force acts on the second, the task is on the first."""
    x, v, force = ca.SX.sym("x", 2), ca.SX.sym("v", 2), ca.SX.sym("force")
    pull = 3.0 * (x[1] - x[0])
    return sg.Mechanism(q=x, u=v, tau=force, Q=ca.diag([1.0, 2.0]), P=ca.vertcat(pull, -pull), G=[0.0, 1.0]), x, v


def test_a_constraint_that_does_not_reach_the_controls() -> None:
    mech, x, v = spring_coupled()
    words = "does not reach the controls", "its row of S is identically zero", "Its relative degree is "
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        four = "4, not 2", "its 4th derivative first", "sg.Output with Theta=[T0, T1, T2, T3]"
        first = sg.Holonomic("first mass", x[0], -2.0, -1.0)
        refused(lambda: built([first], mech), "constraint 'first mass'", *words, *four)
        both = sg.Nonholonomic("speeds", ca.vertcat(v[1], v[0]), -1.0)
        refused(lambda: built([both], mech), "constraint 'speeds', row 1", *words, "3, not 1")
    assert built([sg.Holonomic("second mass", x[1], -2.0, -1.0)], mech).path.is_dir()


def test_an_output_of_another_degree_than_its_theta() -> None:
    mech, x, v = spring_coupled()

    def output(psi: Any, degree: int) -> Callable[[], Any]:
        Theta = [-float(c) for c in np.poly([-1.0] * degree)[:0:-1]]
        return lambda: built([sg.Output("out", psi, Theta)], mech)

    early = "constraint 'out'", "Theta has 4 entries", "its 2nd derivative already", "give Theta=[T0, T1],"
    refused(output(x[1], 4), *early)
    refused(output(x, 4), "constraint 'out', row 1", *early[1:])
    refused(output(v[1] + x[0], 2), "its relative degree is 1; give Theta=[T0],")
    refused(output(x[0], 3), "does not reach the controls", "Its relative degree is 4, not 3")
    refused(lambda: sg.Output("out", x[0], -1.0), "constraint 'out': Theta must be the list [T0, T1, ...]", "-1.0")
    refused(lambda: sg.Output("out", x[0], []), "Theta must be the list")
    refused(lambda: sg.Output("out", x, [-1.0, [1.0, 2.0, 3.0]]), "constraint 'out': T1 has shape 3x1")
    for Theta in ([-1.0, -1.0, 0.0], [-6.0, -1.0, -1.0]):
        refused(lambda Theta=Theta: sg.Output("out", x[0], Theta), "the companion of Theta is unstable", "Hurwitz")
    ideal = [sg.Output("out", x[0], [-1.0, -3.0, -3.0])]
    refused(lambda: scene(ideal, mech, mode="ideal"), "mode='ideal'", "the output 'out'", "leave mode at 'servo'")


def test_a_quantity_that_no_control_moves() -> None:
    free = mechanism(G=ca.DM([[1.0, 0.0], [0.0, 0.0]]))
    refused(lambda: built([sg.Holonomic("free", q[1], -2.0, -1.0)], free), "No control moves it, however often")


def test_why_a_constraint_does_not_reach_the_controls() -> None:
    refused(lambda: built([speed(q[0] - 1)]), "constraint 'speed'", "function of q alone", "declare it as sg.Holonomic")
    refused(lambda: built([speed(ca.SX(0.3))]), "constraint 'speed'", "depends on no state")


def test_a_row_of_zeros_is_found_through_rounding() -> None:
    s, c = ca.sin(q[0]), ca.cos(q[0])
    hidden = (s * s + c * c - 1) * u[0] + q[0]
    refused(lambda: built([speed(hidden)]), "constraint 'speed' does not reach the controls")


def test_a_small_row_is_no_row_of_zeros() -> None:
    assert built([speed(1e-25 * u[0])]).path.is_dir()
    assert built([speed(1e-9 * u[0] * q[0] ** 2)]).path.is_dir()


def test_a_constraint_on_configuration_alone_does_not_reach() -> None:
    refused(lambda: built([speed(q[0])]), "constraint 'speed' does not reach the controls", "derivative")
    law = sg.ControlsInvolved("law", ca.vertcat(tau[0], u[0]))
    refused(lambda: built([law]), "constraint 'law', row 1", "its row of A is identically zero")


def test_duplicate_rows_are_named() -> None:
    pair = [speed(name="one"), speed(2 * u[0] - q[0], name="two")]
    with pytest.warns(sg.Remark, match=r"rows of S can never be independent \(constraint 'one' and constraint 'two'\)"):
        built(pair)
    three, v = ca.SX.sym("q", 3), ca.SX.sym("u", 3)
    mech = sg.Mechanism(q=three, u=v, tau=ca.SX.sym("tau", 3), Q=ca.DM.eye(3), P=ca.DM.zeros(3), G=ca.DM.eye(3))
    rows = sg.Nonholonomic("sum", ca.vertcat(v[0] + v[1], v[1] + v[2], v[0] + 2 * v[1] + v[2]), -1.0)
    with pytest.warns(sg.Remark, match="row 0, constraint 'sum', row 1, constraint 'sum', row 2"):
        built([rows], mech)


def test_independent_rows_raise_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        built([speed(), speed(u[1] + 1e-3 * u[0], name="other")])


def test_a_branch_that_is_not_taken_may_be_nan() -> None:
    psi = u[0] * ca.if_else(q[0] > 10, ca.sqrt(q[0] - 10), 2 + q[0])
    assert built([speed(psi)]).path.is_dir()


def test_messages_are_one_sentence_for_one_line() -> None:
    message = refused(lambda: scene([speed(u[0] * ca.SX.sym("x"))]))
    assert re.fullmatch(r"[^\n]{20,300}", message)


@pytest.mark.parametrize("draw", [lambda generator: 5, lambda generator: 1 / 0, lambda generator: {"q": "here"}])
def test_a_domain_that_cannot_be_drawn_from(draw: Any) -> None:
    with pytest.raises(sg.SceneError, match=r"domain: .*(drawing a state failed|is no list of)"):
        sg.build(drawn_from(draw))


def test_a_solver_that_is_none() -> None:
    with pytest.raises(sg.SceneError, match=r"give an sg\.Solver"):
        drawn_from(None, solver={"rank": "raw"})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sg.build(5), ("sg.build", "sg.Scene", "int")),  # type: ignore[arg-type]
        (lambda: sg.reference("crane"), ("sg.reference", "sg.Scene", "str")),  # type: ignore[arg-type]
        (lambda: sg.build_solver(2.5, 3), ("sg.build_solver(2.5, 3)", "whole numbers, 1 to 12")),  # type: ignore[arg-type]
        (lambda: sg.build_solver(2, 13), ("S of 2 x 13", "1 to 12")),
        (lambda: sg.build_solver(2, 3, solver="svd"), ("solver is str", "sg.Solver")),  # type: ignore[arg-type]
        (lambda: sg.Solver(damping="x"), ("damping='x'", "positive number")),  # type: ignore[arg-type]
        (lambda: sg.Solver(rtol="x"), ("rtol='x'",)),  # type: ignore[arg-type]
        (lambda: sg.Solver(atol=["x"]), ("atol=['x']",)),  # type: ignore[list-item]
        (lambda: sg.Ref(0.0, order=-1), ("sg.Ref(order=-1)", "give 0, 1, 2, ...")),
        (lambda: sg.Ref(0.0, unit=5), ("sg.Ref(unit=5)", "text")),  # type: ignore[arg-type]
        (lambda: sg.Simulation(step=-1.0), ("step = -1.0", "positive")),
        (lambda: sg.Simulation(outputs=3), ("outputs = 3",)),  # type: ignore[arg-type]
    ],
)
def test_what_a_function_cannot_take(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    refused(make, *words)


def test_what_is_a_number_nowhere_is_refused() -> None:
    nowhere = ca.sqrt(-1 - q[0] ** 2)
    refused(lambda: built([speed(u[0] + nowhere)]), "constraint 'speed': psi", "not finite at any state", "domain")
    refused(lambda: built(mech=mechanism(P=ca.vertcat(nowhere, 0))), "z is not finite at any state")
    refused(lambda: built(y=ca.vertcat(nowhere, 0)), "y is not finite at any state")
    refused(lambda: built(domain=lambda rng: {"q": [np.nan, 0.0]}), "domain: the drawn 'q'", "not finite")


def drawn_from(domain: Any, **more: Any) -> sg.Scene:
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM(1), P=-q, G=ca.DM(1))
    return sg.Scene("drawn", mech, [sg.Nonholonomic("speed", u, -1.0)], domain=domain, **more)
