"""Reference counts of a program: what dies with a value, and what a new one brings to life."""

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.program import Program
from servogen.optimise.cost import EARLY, Objective, weight
from servogen.optimise.rewriter import Rewriter


class Cones:
    """Operands, reference counts and costs of a program's nodes and of those appended since."""

    def __init__(self, program: Program, objective: Objective) -> None:
        self.costs = list(objective.node_costs(program))
        self.early = list(depends_on_parameters_alone(program))
        self.args = [i.args for i in program.instrs]
        self.refs = [0] * len(program.instrs)
        for args in self.args:
            for a in args:
                self.refs[a] += 1
        for o in program.outputs:
            for n in o.nodes:
                self.refs[n] += 1

    def release(self, k: int) -> int:
        """Take away the operands of a node; the cost of what dies."""
        dead, stack = 0, [k]
        while stack:
            for a in self.args[stack.pop()]:
                self.refs[a] -= 1
                if self.refs[a] == 0:
                    dead += self.costs[a]
                    stack.append(a)
        return dead

    def hold(self, k: int) -> int:
        """The reverse of `release`: the cost of what comes to life."""
        born, stack = 0, [k]
        while stack:
            for a in self.args[stack.pop()]:
                self.refs[a] += 1
                if self.refs[a] == 1:
                    born += self.costs[a]
                    stack.append(a)
        return born

    def use(self, k: int) -> int:
        """One more reference to a node: the cost of what comes to life."""
        self.refs[k] += 1
        return self.costs[k] + self.hold(k) if self.refs[k] == 1 else 0

    def drop(self, k: int) -> None:
        """One reference less."""
        self.refs[k] -= 1
        if self.refs[k] == 0:
            self.release(k)

    def private(self, k: int) -> int:
        """The cost of a node and of all that serves it alone."""
        dead = self.release(k)
        self.hold(k)
        return dead + self.costs[k]

    def depends(self, k: int, on: int) -> bool:
        stack, seen = [k], {k}
        while stack:
            node = stack.pop()
            if node == on:
                return True
            for a in self.args[node]:
                if a not in seen:
                    seen.add(a)
                    stack.append(a)
        return False

    def extend(self, out: Rewriter, share: float = 1.0) -> None:
        """Take notice of appended nodes; `share`: what an operation at tick counts there."""
        for k in range(len(self.args), len(out.instrs)):
            instr = out.instrs[k]
            self.args.append(instr.args)
            self.refs.append(0)
            early = bool(instr.args) and all(self.early[a] or out.instrs[a].op == "const" for a in instr.args)
            self.early.append(early)
            self.costs.append(round(weight(instr.op) * (EARLY if early else share)))

    def truncate(self, count: int) -> None:
        """Forget the nodes appended since there were `count`; nothing may refer to them any more."""
        for column in (self.args, self.refs, self.early, self.costs):
            del column[count:]
