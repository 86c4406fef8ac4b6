<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Labeling" labelsEnabled="1">
  <renderer-v2 type="RuleRenderer" enableorderby="0" forceraster="0" symbollevels="0">
    <rules key="{a0000000-0000-4000-8000-000000000000}">
      <rule key="{a0000000-0000-4000-8000-000000000001}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &lt; -5" label="height under -5 m" symbol="0"/>
      <rule key="{a0000000-0000-4000-8000-000000000002}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= -5 AND &quot;height_error&quot; &lt; -2" label="height -5 to -2 m" symbol="1"/>
      <rule key="{a0000000-0000-4000-8000-000000000003}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= -2 AND &quot;height_error&quot; &lt; -0.5" label="height -2 to -0.5 m" symbol="2"/>
      <rule key="{a0000000-0000-4000-8000-000000000004}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= -0.5 AND &quot;height_error&quot; &lt; 0.5" label="height -0.5 to 0.5 m" symbol="3"/>
      <rule key="{a0000000-0000-4000-8000-000000000005}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= 0.5 AND &quot;height_error&quot; &lt; 2" label="height 0.5 to 2 m" symbol="4"/>
      <rule key="{a0000000-0000-4000-8000-000000000006}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= 2 AND &quot;height_error&quot; &lt; 5" label="height 2 to 5 m" symbol="5"/>
      <rule key="{a0000000-0000-4000-8000-000000000007}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NOT NULL AND &quot;height_error&quot; &gt;= 5" label="height over 5 m" symbol="6"/>
      <rule key="{a0000000-0000-4000-8000-000000000008}" filter="&quot;wrong&quot; = 0 AND &quot;height_error&quot; IS NULL" label="no height found" symbol="7"/>
      <rule key="{a0000000-0000-4000-8000-000000000009}" filter="&quot;wrong&quot; = 1" label="contradicts the others" symbol="8"/>
      <rule key="{a0000000-0000-4000-8000-000000000010}" filter="&quot;east&quot; IS NOT NULL AND &quot;wrong&quot; = 0" label="planimetric error (10 mm: @length@ m)" symbol="9"/>
    </rules>
    <symbols>
      <symbol type="marker" name="0" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="43,70,140,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="1" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="74,120,190,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="2" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="145,190,220,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="3" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="247,247,247,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="4" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="244,165,130,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="5" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="214,96,77,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="6" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="163,17,46,255"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="7" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="255,255,255,0"/>
            <Option type="QString" name="size" value="2.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="8" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="cross_fill"/>
            <Option type="QString" name="color" value="255,221,0,255"/>
            <Option type="QString" name="size" value="3.2"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,160"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.2"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
      </symbol>
      <symbol type="marker" name="9" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="east"/>
            <Option type="QString" name="y_attribute" value="north"/>
            <Option type="QString" name="scale" value="@scale@"/>
            <Option type="QString" name="vector_field_type" value="0"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@9@0" alpha="1" clip_to_extent="1" force_rhr="0">
            <layer class="ArrowLine" enabled="1" locked="0" pass="0">
              <Option type="Map">
                <Option type="QString" name="arrow_width" value="0.3"/>
                <Option type="QString" name="arrow_start_width" value="0.3"/>
                <Option type="QString" name="arrow_width_unit" value="MM"/>
                <Option type="QString" name="arrow_start_width_unit" value="MM"/>
                <Option type="QString" name="arrow_type" value="0"/>
                <Option type="QString" name="head_type" value="0"/>
                <Option type="QString" name="head_length" value="1.4"/>
                <Option type="QString" name="head_thickness" value="0.8"/>
                <Option type="QString" name="head_length_unit" value="MM"/>
                <Option type="QString" name="head_thickness_unit" value="MM"/>
                <Option type="QString" name="is_curved" value="0"/>
                <Option type="QString" name="is_repeated" value="1"/>
              </Option>
              <symbol type="fill" name="@@9@0@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="29,39,51,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
    </symbols>
  </renderer-v2>
  <labeling type="simple">
    <settings calloutType="simple">
      <text-style fieldName="&quot;id&quot; || coalesce('\n' || CASE WHEN &quot;height_error&quot; &gt;= 0 THEN '+' ELSE '' END || format_number(&quot;height_error&quot;, 2) || ' m', '')" isExpression="1" fontSize="8" fontSizeUnit="Point" textColor="29,39,51,255" textOpacity="1" namedStyle="Regular" multilineHeight="1" blendMode="0">
        <text-buffer bufferDraw="1" bufferSize="0.8" bufferSizeUnits="MM" bufferColor="255,255,255,255" bufferOpacity="0.85" bufferNoFill="1" bufferJoinStyle="128" bufferBlendMode="0"/>
      </text-style>
      <text-format multilineAlign="0" wrapChar="" formatNumbers="0" decimals="3" plussign="0"/>
      <placement placement="6" dist="2" distUnits="MM" priority="5"/>
      <rendering drawLabels="1" obstacle="0" fontMinPixelSize="3" fontMaxPixelSize="10000" upsidedownLabels="0" displayAll="0" limitNumLabels="0" maxNumLabels="2000" scaleVisibility="0" scaleMin="0" scaleMax="0" fontLimitPixelSize="0" labelPerPart="0" mergeLines="0" minFeatureSize="0" obstacleFactor="1" obstacleType="0" zIndex="0"/>
    </settings>
  </labeling>
  <blendMode>0</blendMode>
  <featureBlendMode>0</featureBlendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
