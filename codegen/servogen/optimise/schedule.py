"""An instruction order that keeps few values alive."""

import heapq

from servogen.ir.program import Program, rebuild


def schedule(program: Program) -> Program:
    """Kill-first list scheduling: next comes the ready instruction that ends most lives, then the one defined first.

    The order given is kept where the new one would not keep fewer values alive.
    """
    order = _kill_first(program)
    return rebuild(program, order) if most_alive(program, order) < most_alive(program) else program


def most_alive(program: Program, order: list[int] | None = None) -> int:
    """The largest number of computed values alive at once; inputs and constants cost no register."""
    sequence = list(range(len(program.instrs))) if order is None else order
    outputs = {n for o in program.outputs for n in o.nodes}
    uses = _use_counts(program)
    alive = most = 0
    for k in sequence:
        alive += _computed(program, k)
        most = max(most, alive)
        for a in set(program.instrs[k].args):
            uses[a] -= 1
            if uses[a] == 0 and a not in outputs:
                alive -= _computed(program, a)
    return most


def _computed(program: Program, k: int) -> bool:
    return program.instrs[k].op not in ("input", "const")


def _use_counts(program: Program) -> list[int]:
    counts = [0] * len(program.instrs)
    for instr in program.instrs:
        for a in set(instr.args):
            counts[a] += 1
    return counts


def _kill_first(program: Program) -> list[int]:
    outputs = {n for o in program.outputs for n in o.nodes}
    remaining_uses = _use_counts(program)
    users: list[list[int]] = [[] for _ in program.instrs]
    waiting = []
    for k, instr in enumerate(program.instrs):
        distinct = set(instr.args)
        waiting.append(len(distinct))
        for a in distinct:
            users[a].append(k)

    def kills(k: int) -> int:
        return sum(
            remaining_uses[a] == 1 and a not in outputs and _computed(program, a) for a in set(program.instrs[k].args)
        )

    order: list[int] = []
    done = [False] * len(program.instrs)
    ready: list[tuple[int, int]] = []

    def offer(k: int) -> None:
        if waiting[k] == 0 and not done[k]:
            heapq.heappush(ready, (-kills(k), k))

    def finish(k: int) -> None:
        order.append(k)
        done[k] = True
        for a in set(program.instrs[k].args):
            remaining_uses[a] -= 1
            if remaining_uses[a] == 1:  # whoever uses it last now ends its life
                for user in users[a]:
                    offer(user)
        for user in users[k]:
            waiting[user] -= 1
            offer(user)

    for k in [k for k, w in enumerate(waiting) if w == 0]:
        finish(k)
    while ready:
        _, k = heapq.heappop(ready)
        if not done[k]:
            finish(k)
    return order
