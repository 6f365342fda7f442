"""``python -m stillray_export.products``: the graph of `stillray.models.products`."""

from __future__ import annotations

from onnx import TensorProto, helper

from stillray.io.atomic import atomic_path
from stillray.models.products import FILE

_OPSET, _FORMAT = 18, 9


def graph() -> bytes:
    """The bytes of the file: one product of stacks of matrices, the second of which is turned."""
    node = helper.make_node(
        "FusedMatMul", ["first", "second"], ["products"], domain="com.microsoft", transB=1
    )
    first, second, products = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (
            ("first", ["n", "i", "p"]),
            ("second", ["n", "j", "p"]),
            ("products", ["n", "i", "j"]),
        )
    )
    model = helper.make_model(
        helper.make_graph([node], "products", [first, second], [products]),
        opset_imports=[helper.make_opsetid("", _OPSET), helper.make_opsetid("com.microsoft", 1)],
        ir_version=_FORMAT,
        producer_name="stillray",
    )
    data: bytes = model.SerializeToString()
    return data


def main() -> None:
    """Write the file."""
    with atomic_path(FILE) as temporary:
        temporary.write_bytes(graph())
    print(FILE)


if __name__ == "__main__":
    main()
