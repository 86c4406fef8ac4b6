<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Symbology3D" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <renderer type="rgb" red="Red" green="Green" blue="Blue" pointSize="1" pointSizeUnit="MM" pointSizeMapUnitScale="3x:0,0,0,0,0,0" pointSymbol="0" maximumScreenError="0.3" maximumScreenErrorUnit="MM">
    <redContrastEnhancement>
      <minValue>0</minValue>
      <maxValue>65535</maxValue>
      <algorithm>StretchToMinimumMaximum</algorithm>
    </redContrastEnhancement>
    <greenContrastEnhancement>
      <minValue>0</minValue>
      <maxValue>65535</maxValue>
      <algorithm>StretchToMinimumMaximum</algorithm>
    </greenContrastEnhancement>
    <blueContrastEnhancement>
      <minValue>0</minValue>
      <maxValue>65535</maxValue>
      <algorithm>StretchToMinimumMaximum</algorithm>
    </blueContrastEnhancement>
  </renderer>
  <renderer-3d type="pointcloud" layer="" point-budget="1000000" max-screen-error="1" show-bounding-boxes="0">
    <symbol type="rgb" red="Red" green="Green" blue="Blue" point-size="3">
      <redContrastEnhancement>
        <minValue>0</minValue>
        <maxValue>65535</maxValue>
        <algorithm>StretchToMinimumMaximum</algorithm>
      </redContrastEnhancement>
      <greenContrastEnhancement>
        <minValue>0</minValue>
        <maxValue>65535</maxValue>
        <algorithm>StretchToMinimumMaximum</algorithm>
      </greenContrastEnhancement>
      <blueContrastEnhancement>
        <minValue>0</minValue>
        <maxValue>65535</maxValue>
        <algorithm>StretchToMinimumMaximum</algorithm>
      </blueContrastEnhancement>
    </symbol>
  </renderer-3d>
  <blendMode>0</blendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
