<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Elevation|Temporal" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <elevation enabled="0" symbology="FillBelow" band="1" zscale="1" zoffset="0"/>
  <pipe>
    <provider>
      <resampling enabled="true" maxOversampling="2" zoomedInResamplingMethod="cubic" zoomedOutResamplingMethod="bilinear"/>
    </provider>
    <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" nodataColor="" classificationMin="0" classificationMax="1">
      <rasterTransparency/>
      <minMaxOrigin>
        <limits>None</limits>
        <extent>WholeRaster</extent>
        <statAccuracy>Estimated</statAccuracy>
        <cumulativeCutLower>0.02</cumulativeCutLower>
        <cumulativeCutUpper>0.98</cumulativeCutUpper>
        <stdDevFactor>2</stdDevFactor>
      </minMaxOrigin>
      <rastershader>
        <colorrampshader colorRampType="DISCRETE" classificationMode="1" clip="0" minimumValue="0" maximumValue="1">
          <item value="0.01" color="#0d0887" alpha="255" label="up to 0.01 px"/>
          <item value="0.03" color="#6a00a8" alpha="255" label="0.01 – 0.03 px"/>
          <item value="0.1" color="#b12a90" alpha="255" label="0.03 – 0.1 px"/>
          <item value="0.3" color="#e16462" alpha="255" label="0.1 – 0.3 px"/>
          <item value="1" color="#fca636" alpha="255" label="0.3 – 1 px"/>
          <item value="inf" color="#f0f921" alpha="255" label="over 1 px"/>
        </colorrampshader>
      </rastershader>
    </rasterrenderer>
    <brightnesscontrast brightness="0" contrast="0" gamma="1"/>
    <huesaturation colorizeOn="0" grayscaleMode="0" saturation="0"/>
    <rasterresampler maxOversampling="2" zoomedOutResampler="bilinear"/>
    <resamplingStage>provider</resamplingStage>
  </pipe>
  <blendMode>0</blendMode>
</qgis>
