<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Symbology3D" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <renderer type="ramp" attribute="Z" min="@min@" max="@max@" pointSize="1" pointSizeUnit="MM" pointSizeMapUnitScale="3x:0,0,0,0,0,0" pointSymbol="0" maximumScreenError="0.3" maximumScreenErrorUnit="MM">
@shader@
  </renderer>
  <renderer-3d type="pointcloud" layer="" point-budget="1000000" max-screen-error="1" show-bounding-boxes="0">
    <symbol type="color-ramp" point-size="3" rendering-parameter="Z" color-ramp-shader-min="@min@" color-ramp-shader-max="@max@">
@shader@
    </symbol>
  </renderer-3d>
  <blendMode>0</blendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
