import bpy

wrinkles = bpy.context.object.wrinkles

wrinkles.plan = "PAPER"
wrinkles.use_symmetry = True
