<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- language: de -->
<qgis version="3.22.0" styleCategories="Symbology|Elevation" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <elevation enabled="1" symbology="FillBelow" band="1" zscale="1" zoffset="0"/>
  <pipe>
    <provider>
      <resampling enabled="true" maxOversampling="2" zoomedInResamplingMethod="cubic" zoomedOutResamplingMethod="bilinear"/>
    </provider>
    <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" nodataColor="" classificationMin="187.2223828" classificationMax="234.6392352">
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
    <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" minimumValue="187.2223828" maximumValue="234.6392352" labelPrecision="1">
      <colorramp type="gradient" name="[source]">
        <Option type="Map">
          <Option type="QString" name="color1" value="29,79,74,255"/>
          <Option type="QString" name="color2" value="248,242,234,255"/>
          <Option type="QString" name="discrete" value="0"/>
          <Option type="QString" name="rampType" value="gradient"/>
          <Option type="QString" name="stops" value="0.125;47,111,85,255:0.25;86,138,88,255:0.375;134,160,91,255:0.5;180,174,104,255:0.625;205,178,124,255:0.75;220,191,154,255:0.875;234,214,191,255"/>
        </Option>
      </colorramp>
      <item value="187.2223828" color="#1d4f4a" alpha="255" label="187.2"/>
      <item value="193.1494894" color="#2f6f55" alpha="255" label="193.1"/>
      <item value="199.0765959" color="#568a58" alpha="255" label="199.1"/>
      <item value="205.0037025" color="#86a05b" alpha="255" label="205.0"/>
      <item value="210.930809" color="#b4ae68" alpha="255" label="210.9"/>
      <item value="216.8579156" color="#cdb27c" alpha="255" label="216.9"/>
      <item value="222.7850221" color="#dcbf9a" alpha="255" label="222.8"/>
      <item value="228.7121287" color="#ead6bf" alpha="255" label="228.7"/>
      <item value="234.6392352" color="#f8f2ea" alpha="255" label="234.6"/>
      <rampLegendSettings useContinuousLegend="1" minimumLabel="" maximumLabel="" prefix="" suffix=" m" direction="0" orientation="2">
        <numericFormat id="basic">
          <Option type="Map">
            <Option type="int" name="decimals" value="1"/>
            <Option type="int" name="rounding_type" value="0"/>
            <Option type="bool" name="show_plus" value="false"/>
            <Option type="bool" name="show_thousand_separator" value="false"/>
            <Option type="bool" name="show_trailing_zeros" value="true"/>
          </Option>
        </numericFormat>
      </rampLegendSettings>
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
