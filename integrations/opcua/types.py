"""Orders, states and parameters as structures of OPC 10031-4, and units as those of OPC 10000-8.

The library makes these structures when the nodeset is loaded, so that no type of theirs is known before.
"""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from asyncua import ua as _ua

from integrations.opcua.orders import Order, OrderParameter, OrderRequest
from integrations.opcua.states import OrderState
from tutti import Refusal, Template

ua: Any = _ua
UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
UNITS = {
    **{"m": "MTR", "cm": "CMT", "mm": "MMT", "um": "4H", "nm": "C45", "in": "INH", "deg": "DD", "arcmin": "D61"},
    **{"arcsec": "D62", "rad": "C81", "mrad": "C25", "rev": "M44", "eV": "A53", "keV": "B29"},
}
"""UNECE Recommendation 20; `counts` has no code."""
REQUIREMENTS = ("PersonnelRequirements", "EquipmentRequirements", "PhysicalAssetRequirements", "MaterialRequirements")


def make_unit(unit: str) -> Any:
    """The EUInformation of a unit; its number is the code as a big-endian integer (OPC 10000-8, 5.6.3)."""
    number = int.from_bytes(UNITS[unit].encode(), "big") if unit in UNITS else -1
    return ua.EUInformation(UNECE, number, ua.LocalizedText(unit), ua.LocalizedText(unit))


def read_unit(information: Any) -> str:
    """The unit that a client states, by its code or else by its name; empty if it states none."""
    by_number = {int.from_bytes(code.encode(), "big"): unit for unit, code in UNITS.items()}
    return by_number.get(information.UnitId, information.DisplayName.Text or "") if information is not None else ""


def read_text(texts: Any) -> str:
    """The first of the texts in several languages."""
    entries: list[Any] = texts or []
    return next((text.Text for text in entries if text.Text), "")


def read_request(order: Any) -> OrderRequest:
    """What a client orders. Raises `Refusal`, code `bad-order`."""
    start = order.StartTime
    masters: list[Any] = order.WorkMasterID or []
    parameters: list[Any] = order.JobOrderParameters or []
    return OrderRequest(
        order.JobOrderID or "",
        tuple(master.ID or "" for master in masters),
        tuple(_read_parameter(parameter) for parameter in parameters),
        order.Priority,
        None if start is None else start.replace(tzinfo=start.tzinfo or UTC),
        read_text(order.Description),
        tuple(name for name in REQUIREMENTS if getattr(order, name)),
    )


def _read_parameter(parameter: Any) -> OrderParameter:
    value = parameter.Value.Value
    if parameter.Subparameters or not isinstance(value, bool | int | float | str):
        text = f"parameter {parameter.ID} is no number, text or boolean, or has parameters of its own"
        raise Refusal("bad-order", text, "see the parameters of WorkMaster")
    return OrderParameter(parameter.ID or "", value, read_unit(parameter.EngineeringUnits))


def make_order(request: OrderRequest) -> Any:
    """The order as JobOrderList has it."""
    return ua.ISA95JobOrderDataType(
        JobOrderID=request.id,
        Description=[ua.LocalizedText(request.description)] if request.description else None,
        WorkMasterID=[ua.ISA95WorkMasterDataType(ID=name) for name in request.work_masters],
        StartTime=request.start,
        Priority=request.priority,
        JobOrderParameters=[make_parameter(entry.name, entry.value, entry.unit) for entry in request.parameters],
    )


def make_parameter(name: str, value: Any, unit: str = "", description: str = "") -> Any:
    """A parameter, or a datum of a response."""
    return ua.ISA95ParameterDataType(
        ID=name,
        Value=ua.Variant(value),
        Description=[ua.LocalizedText(description)] if description else None,
        EngineeringUnits=make_unit(unit) if unit else None,
    )


def make_work_masters(templates: Mapping[str, Template]) -> list[Any]:
    """The work masters; the value of each parameter is its default, if it has one."""
    return [
        ua.ISA95WorkMasterDataType(
            ID=name,
            Parameters=[
                make_parameter(key, parameter.default, getattr(parameter, "unit", ""), parameter.description)
                for key, parameter in template.parameters.items()
            ],
        )
        for name, template in templates.items()
    ]


def make_states(state: OrderState, namespace: int) -> list[Any]:
    """A state, and its substate with the path to the state machine that it belongs to."""
    states = [ua.ISA95StateDataType(ua.RelativePath(), ua.LocalizedText(state.name), state.number)]
    if state.substate:
        element = ua.RelativePathElement(
            ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasComponent),
            IncludeSubtypes=True,
            TargetName=ua.QualifiedName(f"{state.name}Substates", namespace),
        )
        path = ua.RelativePath([element])
        states.append(ua.ISA95StateDataType(path, ua.LocalizedText(state.substate), state.substate_number))
    return states


def make_response(order: Order, namespace: int) -> Any:
    """What has become of an order."""
    report = order.report
    return ua.ISA95JobResponseDataType(
        JobResponseID=order.job_id,
        JobOrderID=order.request.id,
        StartTime=_read_utc(order.began_utc),
        EndTime=None if report is None else _read_utc(report.ended_utc),
        JobState=make_states(order.state, namespace),
        JobResponseData=[make_parameter(name, value) for name, value in order.list_results().items()],
    )


def make_list(orders: Iterable[Order], namespace: int) -> Any:
    """JobOrderList."""
    entries = [
        ua.ISA95JobOrderAndStateDataType(make_order(order.request), make_states(order.state, namespace))
        for order in orders
    ]
    return make_array(entries)


def make_array(structures: list[Any]) -> Any:
    """An array of structures, which may be empty."""
    return ua.Variant(structures, ua.VariantType.ExtensionObject, is_array=True)


def _read_utc(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)
