"""Binding times: what parameters alone decide is computed in prepare, the rest at each tick."""

from dataclasses import dataclass

from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.binding import depends_on_parameters_alone, is_constant
from servogen.ir.program import Input, Instr, Output, Program, check_legal, live, rebuild
from servogen.optimise.schedule import schedule


@dataclass(frozen=True)
class Guards:
    """How many pivots are judged: those of Q, then those of the passive constraints."""

    of_mass: int = 0
    joining: int = 0

    @property
    def count(self) -> int:
        return self.of_mass + self.joining


@dataclass(frozen=True)
class Staged:
    """prepare: parameters -> fields of the model (one output each); tick: model and inputs -> the scene's outputs."""

    prepare: Program
    prepare_guards: Guards
    tick: Program
    tick_guards: Guards


def stage(program: Program, joining: int = 0) -> Staged:
    """Split a program in two at the values that depend on parameters alone. joining: the last pivots, which are those
    of the passive constraints."""
    from_parameters = depends_on_parameters_alone(program)
    guards = _guards_by_time(program, from_parameters)
    counts = [_counted(program, pairs, joining) for pairs in guards]
    outputs = [o for o in program.outputs if o.name not in (MASS_PIVOT, MASS_SCALE)]
    if guards[1]:
        outputs += _guard_outputs(guards[1])
    tick_nodes = live(program, (n for o in outputs for n in o.nodes))
    at_tick = {k for k in tick_nodes if not from_parameters[k] and not is_constant(program, k)}
    handed_over = {a for k in at_tick for a in program.instrs[k].args if from_parameters[a]}
    handed_over |= {n for o in outputs for n in o.nodes if from_parameters[n]}
    model, leaf = _name_model(program, sorted(handed_over))
    prepare = _prepare(program, model, guards[0])
    tick = _tick(program, outputs, leaf, model)
    return Staged(schedule(prepare), counts[0], tick, counts[1])


def cut(tick: Program, name: str, outputs: tuple[str, ...]) -> Program:
    """The part of a program that computes the named outputs, in an order of its own."""
    kept = [tick.output(o) for o in outputs]
    nodes = sorted(live(tick, (n for o in kept for n in o.nodes)))
    part = rebuild(tick, nodes, kept)
    return schedule(Program(name, part.inputs, part.instrs, part.outputs))


Pairs = list[tuple[int, int]]


def _guards_by_time(program: Program, from_parameters: tuple[bool, ...]) -> tuple[Pairs, Pairs]:
    """(pivot, scale) pairs judged in prepare, and those judged at each tick."""
    if not any(o.name == MASS_PIVOT for o in program.outputs):
        return [], []
    pairs = list(zip(program.output(MASS_PIVOT).nodes, program.output(MASS_SCALE).nodes, strict=True))

    def early(k: int) -> bool:
        return from_parameters[k] or is_constant(program, k)

    return [p for p in pairs if early(p[0]) and early(p[1])], [p for p in pairs if not (early(p[0]) and early(p[1]))]


def _counted(program: Program, pairs: Pairs, joining: int) -> Guards:
    if not joining:
        return Guards(len(pairs))
    last = program.output(MASS_PIVOT).nodes[-joining:]
    behind = sum(pivot in last for pivot, _ in pairs)
    return Guards(len(pairs) - behind, behind)


def _guard_outputs(pairs: Pairs) -> list[Output]:
    return [
        Output(MASS_PIVOT, len(pairs), 1, tuple(p for p, _ in pairs)),
        Output(MASS_SCALE, len(pairs), 1, tuple(s for _, s in pairs)),
    ]


Model = list[tuple[Input, tuple[int, ...] | None]]  # a field, and its nodes; None: the parameter itself


def _name_model(program: Program, nodes: list[int]) -> tuple[Model, dict[int, tuple[str, int]]]:
    """Fields for values handed over: a parameter keeps its name, a computed value is c0, c1, ..."""
    parameters = [i for i in program.inputs if i.kind == "parameter"]
    taken = {i.name for i in program.inputs}  # the tick's inputs stand beside the fields
    leaf: dict[int, tuple[str, int]] = {}
    model: Model = []
    used = {program.instrs[k].const[0] for k in nodes if isinstance(program.instrs[k].const, tuple)}  # type: ignore[index]
    model += [(Input(i.name, i.size, "model"), None) for i in parameters if i.name in used]
    count = 0
    for k in nodes:
        const = program.instrs[k].const
        if isinstance(const, tuple):
            leaf[k] = const
            continue
        while f"c{count}" in taken:
            count += 1
        leaf[k] = (f"c{count}", 0)
        model.append((Input(f"c{count}", 1, "model"), (k,)))
        count += 1
    return model, leaf


def _prepare(program: Program, model: Model, guards: Pairs) -> Program:
    instrs = list(program.instrs)
    outputs = []
    for entry, nodes in model:
        if nodes is None:
            start = len(instrs)
            instrs += [Instr("input", (), (entry.name, k)) for k in range(entry.size)]
            nodes = tuple(range(start, start + entry.size))
        outputs.append(Output(entry.name, entry.size, 1, nodes))
    if guards:
        outputs += _guard_outputs(guards)
    inputs = tuple(i for i in program.inputs if i.kind == "parameter")
    whole = Program("prepare", program.inputs, tuple(instrs), tuple(outputs))
    part = rebuild(whole, sorted(live(whole, (n for o in outputs for n in o.nodes))))
    return check_legal(Program("prepare", inputs, part.instrs, part.outputs))


def _tick(program: Program, outputs: list[Output], leaf: dict[int, tuple[str, int]], model: Model) -> Program:
    instrs = tuple(Instr("input", (), leaf[k]) if k in leaf else instr for k, instr in enumerate(program.instrs))
    inputs = tuple(entry for entry, _ in model) + tuple(i for i in program.inputs if i.kind != "parameter")
    whole = Program("tick", program.inputs, instrs, tuple(outputs))
    part = rebuild(whole, sorted(live(whole, (n for o in outputs for n in o.nodes))))
    return check_legal(Program("tick", inputs, part.instrs, part.outputs))
