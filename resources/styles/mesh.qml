<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <mesh-renderer-settings>
    <active-dataset-group scalar="0" vector="-1"/>
    <scalar-settings group="0" min-val="@min@" max-val="@max@" opacity="1" interpolation-method="none">
      <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" minimumValue="@min@" maximumValue="@max@" labelPrecision="@precision@">
        <colorramp type="gradient" name="[source]">
          <Option type="Map">
            <Option type="QString" name="color1" value="@first@"/>
            <Option type="QString" name="color2" value="@last@"/>
            <Option type="QString" name="discrete" value="0"/>
            <Option type="QString" name="rampType" value="gradient"/>
            <Option type="QString" name="stops" value="@stops@"/>
          </Option>
        </colorramp>
@items@
        <rampLegendSettings useContinuousLegend="1" minimumLabel="" maximumLabel="" prefix="" suffix=" m" direction="0" orientation="2">
          <numericFormat id="basic">
            <Option type="Map">
              <Option type="int" name="decimals" value="@precision@"/>
              <Option type="int" name="rounding_type" value="0"/>
              <Option type="bool" name="show_plus" value="false"/>
              <Option type="bool" name="show_thousand_separator" value="false"/>
              <Option type="bool" name="show_trailing_zeros" value="true"/>
            </Option>
          </numericFormat>
        </rampLegendSettings>
      </colorrampshader>
      <edge-settings stroke-width-unit="0">
        <mesh-stroke-width use-absolute-value="0" maximum-width="3" minimum-width="0.26" width-varying="0" fixed-width="0.26" minimum-value="@min@" maximum-value="@max@" ignore-out-of-range="0"/>
      </edge-settings>
    </scalar-settings>
  </mesh-renderer-settings>
  <name-to-global-index name="Bed Elevation" global-index="0"/>
  <blendMode>0</blendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
