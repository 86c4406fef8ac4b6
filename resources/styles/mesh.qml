<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Symbology3D" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <mesh-renderer-settings>
    <active-dataset-group scalar="0" vector="-1"/>
    <scalar-settings group="0" min-val="@min@" max-val="@max@" opacity="1" interpolation-method="none">
@shader@
      <edge-settings stroke-width-unit="0">
        <mesh-stroke-width use-absolute-value="0" maximum-width="3" minimum-width="0.26" width-varying="0" fixed-width="0.26" minimum-value="@min@" maximum-value="@max@" ignore-out-of-range="0"/>
      </edge-settings>
    </scalar-settings>
  </mesh-renderer-settings>
  <name-to-global-index name="Bed Elevation" global-index="0"/>
  <renderer-3d type="mesh" layer="">
    <symbol type="mesh">
      <data alt-clamping="relative" height="0" add-back-faces="0"/>
      <material ambient="26,26,26,255" diffuse="178,178,178,255" specular="0,0,0,255" shininess="0"/>
      <advanced-settings renderer-3d-enabled="1" smoothed-triangle="1" wireframe-enabled="0" wireframe-line-width="1" wireframe-line-color="128,128,128,255" level-of-detail="0" vertical-scale="1" vertical-group-index="0" vertical-relative="0" texture-type="1" min-color-ramp-shader="@min@" max-color-ramp-shader="@max@" texture-single-color="128,128,128,255" arrows-enabled="0" arrows-spacing="25" arrows-fixed-size="0">
@shader@
      </advanced-settings>
    </symbol>
  </renderer-3d>
  <blendMode>0</blendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
