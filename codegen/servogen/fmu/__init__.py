"""Controller and plant as Functional Mock-up Units of FMI 3.0, for co-simulation by tools that nobody here wrote."""
