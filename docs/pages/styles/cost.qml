<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- cost.geojson and cost.fgb: regions by class; unknown and impassable ones are hatched. cost.tif: from 1 to 10. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" nodataColor=""
                    classificationMin="1" classificationMax="10">
      <rastershader>
        <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0"
                         minimumValue="1" maximumValue="10" labelPrecision="1">
          <item value="1" label="1: level road" color="#fcfdbf" alpha="255"/>
          <item value="2" label="2" color="#fe9f6d" alpha="255"/>
          <item value="4" label="4" color="#b73779" alpha="255"/>
          <item value="10" label="10 and more" color="#3b0f70" alpha="255"/>
        </colorrampshader>
      </rastershader>
    </rasterrenderer>
  </pipe>
  <renderer-v2 type="categorizedSymbol" attr="CASE WHEN &quot;passable&quot; OR &quot;class_name&quot; = 'unknown' THEN &quot;class_name&quot; ELSE 'not passable' END" symbollevels="0" forceraster="0" enableorderby="0">
    <categories>
      <category value="smooth" label="smooth" render="true" symbol="0"/>
      <category value="fair" label="fair" render="true" symbol="1"/>
      <category value="rough" label="rough" render="true" symbol="2"/>
      <category value="very rough" label="very rough" render="true" symbol="3"/>
      <category value="unknown" label="unknown" render="true" symbol="4"/>
      <category value="not passable" label="not passable" render="true" symbol="5"/>
    </categories>
    <symbols>
      <symbol type="fill" name="0" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="44,123,182,255"/>
            <Option type="QString" name="style" value="solid"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="44,123,182,255"/>
          <prop k="style" v="solid"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
      <symbol type="fill" name="1" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="171,217,233,255"/>
            <Option type="QString" name="style" value="solid"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="171,217,233,255"/>
          <prop k="style" v="solid"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
      <symbol type="fill" name="2" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="253,174,97,255"/>
            <Option type="QString" name="style" value="solid"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="253,174,97,255"/>
          <prop k="style" v="solid"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
      <symbol type="fill" name="3" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="215,25,28,255"/>
            <Option type="QString" name="style" value="solid"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="215,25,28,255"/>
          <prop k="style" v="solid"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
      <symbol type="fill" name="4" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="120,120,120,255"/>
            <Option type="QString" name="style" value="b_diagonal"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="120,120,120,255"/>
          <prop k="style" v="b_diagonal"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
      <symbol type="fill" name="5" alpha="1" clip_to_extent="1" force_rhr="0">
        <layer class="SimpleFill" pass="0" enabled="1" locked="0">
          <Option type="Map">
            <Option type="QString" name="color" value="215,25,28,255"/>
            <Option type="QString" name="style" value="diagonal_x"/>
            <Option type="QString" name="outline_style" value="no"/>
          </Option>
          <prop k="color" v="215,25,28,255"/>
          <prop k="style" v="diagonal_x"/>
          <prop k="outline_style" v="no"/>
        </layer>
      </symbol>
    </symbols>
  </renderer-v2>
</qgis>
