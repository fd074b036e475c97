"""Finding one's way in node trees."""

from __future__ import annotations


def tree_of(item):
    """The node tree that a material, a light or a world is made by; None where its own settings hold."""
    return item.node_tree if getattr(item, "use_nodes", True) else None  # from Blender 6 on there is no choice


def surface_of(item):
    """The node that its surface comes from, if there is one."""
    tree = tree_of(item)
    output = None if tree is None else tree.get_output_node("ALL") or tree.get_output_node("CYCLES")
    return None if output is None else source(output.inputs["Surface"])


def source(socket):
    """The node that feeds an input, past reroutes; None where its own value holds."""
    while socket.is_linked and socket.links:
        node = socket.links[0].from_node
        if node.type != "REROUTE":
            return node
        socket = node.inputs[0]
    return None


def constant(socket):
    """The value of an input that no node changes; None where one does."""
    node = source(socket)
    if node is None:
        return socket.default_value
    return node.outputs[0].default_value if node.type in ("VALUE", "RGB") else None
