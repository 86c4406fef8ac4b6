<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|Labeling" labelsEnabled="0">
  <renderer-v2 type="graduatedSymbol" attr="residual" graduatedMethod="GraduatedColor" enableorderby="0" forceraster="0" symbollevels="0">
    <ranges>
      <range symbol="0" lower="0.000000" upper="0.100000" label="up to 0.1 px" render="true"/>
      <range symbol="1" lower="0.100000" upper="0.200000" label="0.1 – 0.2 px" render="true"/>
      <range symbol="2" lower="0.200000" upper="0.300000" label="0.2 – 0.3 px" render="true"/>
      <range symbol="3" lower="0.300000" upper="0.500000" label="0.3 – 0.5 px" render="true"/>
      <range symbol="4" lower="0.500000" upper="1.000000" label="0.5 – 1 px" render="true"/>
      <range symbol="5" lower="1.000000" upper="1000000000.000000" label="over 1 px" render="true"/>
    </ranges>
    <symbols>
      <symbol type="marker" name="0" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="26,152,80,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@0@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@0@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="26,152,80,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
      <symbol type="marker" name="1" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="127,191,63,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@1@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@1@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="127,191,63,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
      <symbol type="marker" name="2" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="217,200,38,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@2@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@2@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="217,200,38,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
      <symbol type="marker" name="3" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="243,154,39,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@3@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@3@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="243,154,39,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
      <symbol type="marker" name="4" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="221,90,43,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@4@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@4@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="221,90,43,255"/>
                    <Option type="QString" name="style" value="solid"/>
                    <Option type="QString" name="outline_style" value="no"/>
                  </Option>
                </layer>
              </symbol>
            </layer>
          </symbol>
        </layer>
      </symbol>
      <symbol type="marker" name="5" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="name" value="circle"/>
            <Option type="QString" name="color" value="163,17,46,255"/>
            <Option type="QString" name="size" value="1.6"/>
            <Option type="QString" name="size_unit" value="MM"/>
            <Option type="QString" name="outline_color" value="40,40,40,140"/>
            <Option type="QString" name="outline_style" value="solid"/>
            <Option type="QString" name="outline_width" value="0.1"/>
            <Option type="QString" name="outline_width_unit" value="MM"/>
            <Option type="QString" name="scale_method" value="diameter"/>
          </Option>
        </layer>
        <layer class="VectorField" enabled="1" locked="0" pass="0">
          <Option type="Map">
            <Option type="QString" name="x_attribute" value="row"/>
            <Option type="QString" name="y_attribute" value="direction"/>
            <Option type="QString" name="scale" value="20"/>
            <Option type="QString" name="vector_field_type" value="1"/>
            <Option type="QString" name="angle_orientation" value="0"/>
            <Option type="QString" name="angle_units" value="0"/>
            <Option type="QString" name="distance_unit" value="MM"/>
            <Option type="QString" name="distance_map_unit_scale" value="3x:0,0,0,0,0,0"/>
            <Option type="QString" name="size" value="1"/>
            <Option type="QString" name="size_unit" value="MM"/>
          </Option>
          <symbol type="line" name="@5@1" alpha="1" clip_to_extent="1" force_rhr="0">
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
              <symbol type="fill" name="@@5@1@0" alpha="1" clip_to_extent="1" force_rhr="0">
                <layer class="SimpleFill" enabled="1" locked="0" pass="0">
                  <Option type="Map">
                    <Option type="QString" name="color" value="163,17,46,255"/>
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
  <blendMode>0</blendMode>
  <featureBlendMode>0</featureBlendMode>
  <layerOpacity>1</layerOpacity>
</qgis>
