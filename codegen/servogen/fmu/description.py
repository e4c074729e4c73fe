"""modelDescription.xml and buildDescription.xml of a unit, as FMI 3.0 wants them."""

from collections.abc import Iterable
from xml.etree import ElementTree as ET

from servogen.fmu.variables import Variable
from servogen.version import VERSION


def model_description(
    identifier: str,
    title: str,
    token: str,
    variables: Iterable[Variable],
    methods: tuple[str, ...],
    experiment: dict[str, str],
) -> str:
    """variables: all, in the order of their references. methods: items of the enumeration Method, if one uses it."""
    known = list(variables)
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": "3.0",
            "modelName": identifier,
            "instantiationToken": token,
            "description": title,
            "generationTool": f"servogen {VERSION}",
            "variableNamingConvention": "structured",
        },
    )
    ET.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": identifier,
            "canHandleVariableCommunicationStepSize": "true",
            "canGetAndSetFMUState": "true",
            "canSerializeFMUState": "true",
        },
    )
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in known if v.unit}):
        ET.SubElement(units, "Unit", {"name": unit})
    if any(v.enumeration for v in known):
        types = ET.SubElement(root, "TypeDefinitions")
        items = ET.SubElement(types, "EnumerationType", {"name": "Method"})
        for k, name in enumerate(methods):
            ET.SubElement(items, "Item", {"name": name, "value": str(k)})
    log = ET.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ET.SubElement(log, "Category", {"name": name})
    ET.SubElement(root, "DefaultExperiment", experiment)
    listed = ET.SubElement(root, "ModelVariables")
    for v in known:
        _variable(listed, v)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [v for v in known if v.causality == "output"]
    for v in outputs:
        ET.SubElement(structure, "Output", {"valueReference": str(v.reference)})
    for v in outputs:
        if v.initial == "calculated":
            ET.SubElement(structure, "InitialUnknown", {"valueReference": str(v.reference)})
    return _text(root)


def _variable(parent: ET.Element, v: Variable) -> None:
    told = {"name": v.name, "valueReference": str(v.reference), "causality": v.causality, "variability": v.variability}
    told |= {"description": v.text} if v.text else {}
    told |= {"initial": v.initial} if v.initial else {}
    told |= {"unit": v.unit} if v.unit else {}
    told |= {"declaredType": v.enumeration} if v.enumeration else {}
    told |= {"start": v.start_text} if v.start else {}
    element = ET.SubElement(parent, "Enumeration" if v.enumeration else v.type, told)
    if v.size > 1:
        ET.SubElement(element, "Dimension", {"start": str(v.size)})


def build_description(identifier: str, sources: Iterable[str], definitions: dict[str, str]) -> str:
    """sources: C files in the folder `sources`, all compiled together."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": identifier})
    same_bits = {"compiler": "gcc", "compilerOptions": "-ffp-contract=off"}  # no fused multiply-add behind the code
    together = ET.SubElement(configuration, "SourceFileSet", {"language": "C99", **same_bits})
    for name in sources:
        ET.SubElement(together, "SourceFile", {"name": name})
    for name, value in definitions.items():
        ET.SubElement(together, "PreprocessorDefinition", {"name": name, "value": value})
    plain = {"name": "FMI3_OVERRIDE_FUNCTION_PREFIX", "value": "1", "optional": "true"}
    told = "for a shared library: the functions' names without the model identifier"
    ET.SubElement(together, "PreprocessorDefinition", {**plain, "description": told})
    ET.SubElement(configuration, "Library", {"name": "m", "external": "true"})
    return _text(root)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
