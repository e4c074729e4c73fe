"""The pseudo-inverse alone beside Eigen and LAPACK: python -m servogen.bench.solver.run."""
