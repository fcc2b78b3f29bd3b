"""Show surflux clouds and bakes in Blender, colored, without a click:

    blender -P examples/blender/show.py -- cloud.usdc bake/asset_baked.usda

or from a script of your own: show.cloud("cloud.usdc"), show.bake("asset_baked.usda", "occlusion").
"""
import sys

import bpy


def _emission(name, attribute):
    """A material that shines with the values of `attribute`, as they are."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    source = nodes.new("ShaderNodeAttribute")
    source.attribute_name = attribute
    emission = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(source.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs["Emission"], output.inputs["Surface"])
    return material


def _import(path):
    before = set(bpy.data.objects)
    bpy.ops.wm.usd_import(filepath=str(path))
    return [o for o in bpy.data.objects if o not in before]


def cloud(path, attribute="displayColor"):
    """Import the cloud at `path`; returns its point cloud objects. Every surfel is a ball of its
    radius: where a wall has surfels on both sides, balls of both stand in one place. For disks on their own side, make a mesh
    first, `surflux convert cloud.usdc mesh.usdc --display-mesh`, and import that."""
    clouds = [o for o in _import(path) if o.type == "POINTCLOUD"]
    if not clouds:
        raise ValueError(f"{path} has no points")
    material = _emission(f"surflux {attribute}", attribute)
    for o in clouds:
        if attribute not in o.data.attributes:
            raise ValueError(f"{path} has no {attribute}; there are: {', '.join(o.data.attributes.keys())}")
        o.data.materials.clear()
        o.data.materials.append(material)
    return clouds


def bake(path, attribute=None):
    """Import the stage of a bake, NAME_baked.usda; returns its mesh objects. It shows what it was baked to show; give the
    name of an AOV to see that instead."""
    meshes = [o for o in _import(path) if o.type == "MESH"]
    if attribute is None:
        return meshes
    shown = [o for o in meshes if attribute in o.data.attributes]
    if not shown:
        raise ValueError(f"{path} has no {attribute} on any mesh")
    material = _emission(f"surflux {attribute}", attribute)
    for o in shown:
        o.data.materials.clear()
        o.data.materials.append(material)
    return meshes


def plain_colors():
    """Show light as it is stored: no look of Blender's on it."""
    bpy.context.scene.view_settings.view_transform = "Standard"


if __name__ == "__main__":
    for name in sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []:
        if name.endswith("_baked.usda"):
            bake(name)
        else:
            cloud(name)
    plain_colors()
