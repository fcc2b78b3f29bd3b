"""Export a point cloud of Blender's so that surflux gathers from it:

    blender scene.blend -b -P examples/blender/export_cloud.py -- CLOUD_OBJECT cloud.usdc
    surflux bake asset.usd -o asset.usdc --aov irradiance_indirect --cloud cloud.usdc

Points need a direction: a vector attribute N. Their light is the color attribute displayColor, radiance; their size is
Blender's radius.
"""
import sys

import bpy


def export(cloud, path):
    """Write the point cloud object `cloud` to `path`."""
    if cloud.type != "POINTCLOUD":
        raise ValueError(f"{cloud.name} is a {cloud.type}, not a point cloud (convert it first)")
    attributes = cloud.data.attributes
    if len(cloud.data.points) == 0:
        raise ValueError(f"{cloud.name} has no points (Blender's exporter fails on none)")
    for name, kind in [("N", "FLOAT_VECTOR"), ("displayColor", "FLOAT_COLOR")]:
        if name not in attributes or attributes[name].data_type != kind:
            raise ValueError(f"{cloud.name} has no attribute {name} of type {kind} on its points")
    for o in bpy.context.view_layer.objects:
        o.select_set(o == cloud)
    bpy.context.view_layer.objects.active = cloud
    bpy.ops.wm.usd_export(filepath=str(path), selected_objects_only=True, export_materials=False, export_animation=False)


if __name__ == "__main__":
    name, path = sys.argv[sys.argv.index("--") + 1:]
    export(bpy.data.objects[name], path)
