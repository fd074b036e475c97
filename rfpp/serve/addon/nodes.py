"""Queries of node trees."""

from __future__ import annotations


def tree_of(owner):
    """Return the node tree of a material, light or world; None if it uses its own settings."""
    return owner.node_tree if getattr(owner, "use_nodes", True) else None  # Blender 6 always uses nodes


def surface_of(owner):
    """Return the node connected to the surface output, or None."""
    tree = tree_of(owner)
    output = None if tree is None else tree.get_output_node("ALL") or tree.get_output_node("CYCLES")
    return None if output is None else source(output.inputs["Surface"])


def source(socket):
    """Return the node that feeds an input, past reroutes; None if the input has its own value."""
    while socket.is_linked and socket.links:
        node = socket.links[0].from_node
        if node.type != "REROUTE":
            return node
        socket = node.inputs[0]
    return None


def constant(socket):
    """Return the value of an input; None if a node computes it."""
    node = source(socket)
    if node is None:
        return socket.default_value
    return node.outputs[0].default_value if node.type in ("VALUE", "RGB") else None
