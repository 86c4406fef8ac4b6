<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE TS>
<TS version="2.1" language="de" sourcelanguage="en">
<context>
    <name>Batch</name>
    <message>
        <source>Make DSMs of many scenes</source>
        <translation>DOM vieler Szenen erzeugen</translation>
    </message>
    <message>
        <source>A DSM of each subfolder, STAC item or row of a table, with a layer and a report of all of them.</source>
        <translation>Ein DOM für jeden Unterordner, jedes STAC-Element oder jede Zeile einer Tabelle, mit einem Layer und einem Bericht über alle.</translation>
    </message>
    <message>
        <source>Folder of scenes</source>
        <translation>Ordner mit Szenen</translation>
    </message>
    <message>
        <source>Tables and STAC files</source>
        <translation>Tabellen und STAC-Dateien</translation>
    </message>
    <message>
        <source>Table or STAC file of scenes</source>
        <translation>Tabelle oder STAC-Datei mit Szenen</translation>
    </message>
    <message>
        <source>Products of each scene beside its DSM</source>
        <translation>Produkte jeder Szene neben ihrem DOM</translation>
    </message>
    <message>
        <source>Each of its subfolders and ZIP or TAR files is a scene: it holds the images with RPCs.</source>
        <translation>Jeder Unterordner und jede ZIP- oder TAR-Datei darin ist eine Szene: darin liegen die Bilder mit RPC.</translation>
    </message>
    <message>
        <source>In place of a folder: a CSV file with a row for each scene, whose columns are scene (its name), images (files, a folder or an archive; with ; between) and options in small letters, such as extent or resolution, which go before those below. Or a STAC item, collection or catalogue.</source>
        <translation>Anstelle eines Ordners: eine CSV-Datei mit einer Zeile je Szene, deren Spalten scene (ihr Name), images (Dateien, ein Ordner oder ein Archiv; mit ; dazwischen) und Optionen in Kleinbuchstaben sind, etwa extent oder resolution, die denen unten vorgehen. Oder ein Element, eine Sammlung oder ein Katalog von STAC.</translation>
    </message>
    <message>
        <source>Each takes time and space for each scene.</source>
        <translation>Jedes kostet bei jeder Szene Zeit und Platz.</translation>
    </message>
    <message>
        <source>The scenes that were complete by then are in '{path}'.</source>
        <translation>Die bis dahin fertigen Szenen sind in „{path}“.</translation>
    </message>
</context>
<context>
    <name>Buildings</name>
    <message>
        <source>Find buildings: footprints, heights, roofs</source>
        <translation>Gebäude finden: Grundrisse, Höhen, Dächer</translation>
    </message>
    <message>
        <source>Footprints with heights and their errors, and closed solids with simple roofs (CityJSON).</source>
        <translation>Grundrisse mit Höhen und deren Fehlern, und geschlossene Körper mit einfachen Dächern (CityJSON).</translation>
    </message>
    <message>
        <source>DSM with houses and trees</source>
        <translation>DOM mit Häusern und Bäumen</translation>
    </message>
    <message>
        <source>A surface model of this plugin or of others, in a projected CRS; heights in metres.</source>
        <translation>Ein Oberflächenmodell dieses Plugins oder anderer Programme, in einem projizierten KBS; Höhen in Metern.</translation>
    </message>
    <message>
        <source>Terrain below it (DTM)</source>
        <translation>Gelände darunter (DGM)</translation>
    </message>
    <message>
        <source>Bare earth in any CRS, such as that of Find the terrain below houses and trees. Empty: it is made of the DSM first.</source>
        <translation>Der nackte Boden in beliebigem KBS, etwa der von „Gelände unter Häusern und Bäumen finden“. Leer: Er wird zuerst aus dem DOM abgeleitet.</translation>
    </message>
    <message>
        <source>Confidence of the DSM</source>
        <translation>Konfidenz des DOM</translation>
    </message>
    <message>
        <source>The raster that was written with the DSM: heights that were filled in do not count, and the errors of the heights follow from it.</source>
        <translation>Das Raster, das mit dem DOM geschrieben wurde: Aufgefüllte Höhen zählen nicht, und die Fehler der Höhen ergeben sich daraus.</translation>
    </message>
    <message>
        <source>Orthophoto with near infrared</source>
        <translation>Orthophoto mit nahem Infrarot</translation>
    </message>
    <message>
        <source>A picture whose bands are named red and near infrared: where it is green, there are trees. Without it, smooth crowns may be taken for small buildings.</source>
        <translation>Ein Bild, dessen Kanäle red und near infrared heißen: Wo es grün ist, stehen Bäume. Ohne dieses können glatte Kronen für kleine Gebäude gehalten werden.</translation>
    </message>
    <message>
        <source>Lowest building (m)</source>
        <translation>Niedrigstes Gebäude (m)</translation>
    </message>
    <message>
        <source>Above the terrain; lower things are cars, hedges and garden sheds.</source>
        <translation>Über dem Gelände; niedriger sind Autos, Hecken und Gartenhäuser.</translation>
    </message>
    <message>
        <source>Smallest building (m²)</source>
        <translation>Kleinstes Gebäude (m²)</translation>
    </message>
    <message>
        <source>The area of the footprint. Below 50 m², many of the smaller things are crowns of trees.</source>
        <translation>Die Fläche des Grundrisses. Unter 50 m² sind viele der kleineren Dinge Baumkronen.</translation>
    </message>
</context>
<context>
    <name>Change</name>
    <message>
        <source>Find changes between two dates</source>
        <translation>Änderungen zwischen zwei Zeitpunkten finden</translation>
    </message>
    <message>
        <source>What was built, removed or dug away between two DSMs, with volumes and their uncertainty.</source>
        <translation>Was zwischen zwei DOM gebaut, entfernt oder abgetragen wurde, mit Volumen und deren Unsicherheit.</translation>
    </message>
    <message>
        <source>DSM of the first date</source>
        <translation>DOM des ersten Zeitpunkts</translation>
    </message>
    <message>
        <source>A raster of heights in metres, in any CRS.</source>
        <translation>Ein Raster mit Höhen in Metern, in beliebigem KBS.</translation>
    </message>
    <message>
        <source>DSM of the second date</source>
        <translation>DOM des zweiten Zeitpunkts</translation>
    </message>
    <message>
        <source>A raster of heights in metres, in any CRS; it may have other cells than that of the first date.</source>
        <translation>Ein Raster mit Höhen in Metern, in beliebigem KBS; es darf andere Zellen haben als das des ersten Zeitpunkts.</translation>
    </message>
    <message>
        <source>Confidence of the first date</source>
        <translation>Konfidenz des ersten Zeitpunkts</translation>
    </message>
    <message>
        <source>The confidence raster that was made with the DSM, or one band with the expected error in metres. Give both dates', or none: then the errors are estimated from ground that did not change, and a change must be twice as large to be shown.</source>
        <translation>Das Konfidenzraster, das mit dem DOM entstanden ist, oder ein Kanal mit dem erwarteten Fehler in Metern. Für beide Zeitpunkte angeben oder für keinen: dann werden die Fehler aus unverändertem Boden geschätzt, und eine Änderung muss doppelt so groß sein, damit sie gezeigt wird.</translation>
    </message>
    <message>
        <source>Confidence of the second date</source>
        <translation>Konfidenz des zweiten Zeitpunkts</translation>
    </message>
    <message>
        <source>As for the first date.</source>
        <translation>Wie beim ersten Zeitpunkt.</translation>
    </message>
    <message>
        <source>Alignment on stable ground</source>
        <translation>Ausrichtung auf stabilem Boden</translation>
    </message>
    <message>
        <source>3d: the second DSM is moved in all three axes until the ground that did not change agrees; vertical: it is moved up or down only; none: both already fit.</source>
        <translation>3d: Das zweite DOM wird in allen drei Achsen verschoben, bis der unveränderte Boden übereinstimmt; vertical: nur nach oben oder unten; none: beide passen schon.</translation>
    </message>
    <message>
        <source>Smallest change (m²)</source>
        <translation>Kleinste Änderung (m²)</translation>
    </message>
    <message>
        <source>Smaller changes are left out: 50 m² keeps small houses and drops cars and single trees.</source>
        <translation>Kleinere Änderungen werden weggelassen: 50 m² behält kleine Häuser und lässt Autos und einzelne Bäume weg.</translation>
    </message>
</context>
<context>
    <name>CheckGcps</name>
    <message>
        <source>Check against ground control points</source>
        <translation>Gegen Passpunkte prüfen</translation>
    </message>
    <message>
        <source>How far points of known position are from where RPCs, corrected RPCs and a DSM put them.</source>
        <translation>Wie weit Punkte bekannter Lage von dort entfernt sind, wohin RPC, korrigierte RPC und ein DOM sie legen.</translation>
    </message>
    <message>
        <source>Scene (for the images' geometry)</source>
        <translation>Szene (für die Geometrie der Bilder)</translation>
    </message>
    <message>
        <source>The scene.json of any stage; a reconstructed scene also shows how accurate its pointing is.</source>
        <translation>Die scene.json irgendeiner Stufe; eine rekonstruierte Szene zeigt auch, wie genau ihre Ausrichtung ist.</translation>
    </message>
    <message>
        <source>DSM (for the heights at the points)</source>
        <translation>DOM (für die Höhen an den Punkten)</translation>
    </message>
    <message>
        <source>Its heights are compared with those of the points that lie on it.</source>
        <translation>Seine Höhen werden mit denen der Punkte verglichen, die darauf liegen.</translation>
    </message>
</context>
<context>
    <name>ClientPage</name>
    <message>
        <source>Digital surface model from satellite images</source>
        <translation>Digitales Oberflächenmodell aus Satellitenbildern</translation>
    </message>
    <message>
        <source>Orthophoto</source>
        <translation>Orthophoto</translation>
    </message>
    <message>
        <source>Images: their providers. Surface model: REPM {version}.</source>
        <translation>Bilder: ihre Anbieter. Oberflächenmodell: REPM {version}.</translation>
    </message>
    <message>
        <source>date unknown</source>
        <translation>Datum unbekannt</translation>
    </message>
    <message>
        <source>Images</source>
        <translation>Bilder</translation>
    </message>
    <message>
        <source>Cells</source>
        <translation>Zellen</translation>
    </message>
    <message>
        <source>Extent</source>
        <translation>Ausdehnung</translation>
    </message>
    <message>
        <source>CRS</source>
        <translation>KBS</translation>
    </message>
    <message>
        <source>Heights above</source>
        <translation>Höhen über</translation>
    </message>
    <message>
        <source>Position</source>
        <translation>Lage</translation>
    </message>
    <message>
        <source>by control or a reference</source>
        <translation>nach Passpunkten oder einer Referenz</translation>
    </message>
    <message>
        <source>as the images' RPCs have it</source>
        <translation>nach den RPC der Bilder</translation>
    </message>
    <message>
        <source>Heights</source>
        <translation>Höhen</translation>
    </message>
</context>
<context>
    <name>CompareDsm</name>
    <message>
        <source>Compare a DSM with a reference</source>
        <translation>DOM mit einer Referenz vergleichen</translation>
    </message>
    <message>
        <source>Height errors of a DSM: map, statistics and completeness, after an optional alignment.</source>
        <translation>Höhenfehler eines DOM: Karte, Statistik und Vollständigkeit, auf Wunsch nach einer Ausrichtung.</translation>
    </message>
    <message>
        <source>DSM or point cloud to measure</source>
        <translation>Zu prüfendes DOM oder zu prüfende Punktwolke</translation>
    </message>
    <message>
        <source>A raster of heights in metres, in any CRS, which is resampled to the reference's cells; or a point cloud (LAZ, LAS).</source>
        <translation>Ein Raster von Höhen in Metern in beliebigem KBS, das auf die Zellen der Referenz umgerechnet wird; oder eine Punktwolke (LAZ, LAS).</translation>
    </message>
    <message>
        <source>Reference (DSM or point cloud)</source>
        <translation>Referenz (DOM oder Punktwolke)</translation>
    </message>
    <message>
        <source>A raster of heights in metres that are assumed to be right, such as one from lidar; or a point cloud (LAZ, LAS), whose first returns become means on the DSM's cells.</source>
        <translation>Ein Raster von Höhen in Metern, die als richtig gelten, etwa aus Lidar; oder eine Punktwolke (LAZ, LAS), deren erste Echos auf den Zellen des DOM gemittelt werden.</translation>
    </message>
    <message>
        <source>Alignment before the comparison</source>
        <translation>Ausrichtung vor dem Vergleich</translation>
    </message>
    <message>
        <source>none: no alignment; vertical: a constant offset in height is removed; 3d: a shift in all three axes is removed, found by the slopes of cells; icp: such a shift, found by the nearest points of flat parts, which is more repeatable against point clouds and takes longer.</source>
        <translation>none: keine Ausrichtung; vertical: ein konstanter Höhenversatz wird entfernt; 3d: eine Verschiebung in allen drei Achsen wird entfernt, aus den Neigungen der Zellen bestimmt; icp: eine solche Verschiebung, aus den nächsten Punkten ebener Stellen bestimmt, was bei Punktwolken besser wiederholbar ist und länger dauert.</translation>
    </message>
    <message>
        <source>Thresholds of the completeness (m)</source>
        <translation>Schwellen der Vollständigkeit (m)</translation>
    </message>
    <message>
        <source>For each of these: the share of the reference's cells whose height is right to within it.</source>
        <translation>Für jede dieser Schwellen: der Anteil der Zellen der Referenz, deren Höhe bis auf sie richtig ist.</translation>
    </message>
    <message>
        <source>Further DSMs for the same table</source>
        <translation>Weitere DOM für dieselbe Tabelle</translation>
    </message>
    <message>
        <source>Other DSMs of the same ground, such as another program's, as rasters or point clouds (LAZ, LAS): the report shows all of them side by side, each aligned on its own.</source>
        <translation>Andere DOM desselben Gebiets, etwa eines anderen Programms, als Raster oder Punktwolken (LAZ, LAS): Der Bericht zeigt alle nebeneinander, jedes für sich ausgerichtet.</translation>
    </message>
    <message>
        <source>Class raster</source>
        <translation>Klassenraster</translation>
    </message>
    <message>
        <source>Whole numbers such as those of a land cover map or a mask, in any CRS: the report gives the errors of each class.</source>
        <translation>Ganze Zahlen, etwa einer Landbedeckungskarte oder einer Maske, in beliebigem KBS: Der Bericht nennt die Fehler jeder Klasse.</translation>
    </message>
    <message>
        <source>Profile lines</source>
        <translation>Profillinien</translation>
    </message>
    <message>
        <source>Lines along which heights are shown, named by their field 'name'. Empty: two lines through the middle.</source>
        <translation>Linien, entlang derer Höhen gezeigt werden, benannt nach ihrem Feld 'name'. Leer: zwei Linien durch die Mitte.</translation>
    </message>
</context>
<context>
    <name>ConfidenceLink</name>
    <message>
        <source>Link to the confidence</source>
        <translation>Verweis auf die Konfidenz</translation>
    </message>
    <message>
        <source>Expected errors (confidence)</source>
        <translation>Erwartete Fehler (Konfidenz)</translation>
    </message>
    <message>
        <source>Shows the error that each height is expected to have, or hides it again.</source>
        <translation>Zeigt den Fehler, der für jede Höhe zu erwarten ist, oder blendet ihn wieder aus.</translation>
    </message>
    <message>
        <source>The confidence of this DSM is not in this project any more.</source>
        <translation>Die Konfidenz dieses DOM ist nicht mehr in diesem Projekt.</translation>
    </message>
</context>
<context>
    <name>ControlPointsDock</name>
    <message>
        <source>1. Images or scene…</source>
        <translation>1. Bilder oder Szene…</translation>
    </message>
    <message>
        <source>2. Points</source>
        <translation>2. Punkte</translation>
    </message>
    <message>
        <source>New point on the map</source>
        <translation>Neuer Punkt auf der Karte</translation>
    </message>
    <message>
        <source>Undo</source>
        <translation>Rückgängig</translation>
    </message>
    <message>
        <source>Delete point</source>
        <translation>Punkt löschen</translation>
    </message>
    <message>
        <source>3. Save for GCPS…</source>
        <translation>3. Für GCPS speichern…</translation>
    </message>
    <message>
        <source>WGS 84 ellipsoid</source>
        <translation>WGS-84-Ellipsoid</translation>
    </message>
    <message>
        <source>The vertical datum of a table's heights when it is loaded: the ellipsoid, EGM96, EGM2008, or a vertical CRS such as EPSG:5773. They are saved above the ellipsoid: leave GCP_DATUM empty then.</source>
        <translation>Der Höhenbezug der Höhen einer Tabelle, wenn sie geladen wird: das Ellipsoid, EGM96, EGM2008 oder ein Höhensystem wie EPSG:5773. Gespeichert werden sie über dem Ellipsoid: GCP_DATUM bleibt dann leer.</translation>
    </message>
    <message>
        <source>Where a new point takes its height from; empty: you are asked for it.</source>
        <translation>Woher ein neuer Punkt seine Höhe nimmt; leer: sie wird erfragt.</translation>
    </message>
    <message>
        <source>Heights of tables:</source>
        <translation>Höhen der Tabellen:</translation>
    </message>
    <message>
        <source>New heights from:</source>
        <translation>Neue Höhen aus:</translation>
    </message>
    <message>
        <source>Page Up and Page Down go to another point. Double click a value to change it.</source>
        <translation>Bild auf und Bild ab wechseln den Punkt. Ein Doppelklick auf einen Wert ändert ihn.</translation>
    </message>
    <message>
        <source>New point</source>
        <translation>Neuer Punkt</translation>
    </message>
    <message>
        <source>Height above the WGS 84 ellipsoid (m):</source>
        <translation>Höhe über dem WGS-84-Ellipsoid (m):</translation>
    </message>
    <message>
        <source>Images and scenes</source>
        <translation>Bilder und Szenen</translation>
    </message>
    <message>
        <source>Images of the same ground, or a scene</source>
        <translation>Bilder desselben Geländes, oder eine Szene</translation>
    </message>
    <message>
        <source>From a file…</source>
        <translation>Aus einer Datei…</translation>
    </message>
    <message>
        <source>Tables and point layers</source>
        <translation>Tabellen und Punktlayer</translation>
    </message>
    <message>
        <source>Control points</source>
        <translation>Passpunkte</translation>
    </message>
    <message>
        <source>Save for GCPS</source>
        <translation>Für GCPS speichern</translation>
    </message>
    <message>
        <source>not saved</source>
        <translation>nicht gespeichert</translation>
    </message>
    <message>
        <source>Measure control points</source>
        <translation>Passpunkte messen</translation>
    </message>
    <message>
        <source>not visible here</source>
        <translation>hier nicht sichtbar</translation>
    </message>
    <message>
        <source>from the RPC: {col}, {row} px</source>
        <translation>zum RPC: {col}, {row} px</translation>
    </message>
    <message>
        <source>outside this image</source>
        <translation>außerhalb dieses Bildes</translation>
    </message>
    <message>
        <source>click the point</source>
        <translation>den Punkt anklicken</translation>
    </message>
    <message>
        <source>Choose the images, or the scene of a run, that show the points.</source>
        <translation>Die Bilder oder die Szene eines Laufs wählen, die die Punkte zeigen.</translation>
    </message>
    <message>
        <source>Load points, or press New point on the map and click the place on an orthophoto.</source>
        <translation>Punkte laden, oder „Neuer Punkt auf der Karte“ drücken und die Stelle auf einem Orthofoto anklicken.</translation>
    </message>
    <message>
        <source>Point {name}: mark it in at least two images.</source>
        <translation>Punkt {name}: in mindestens zwei Bildern markieren.</translation>
    </message>
    <message>
        <source>Point {name}: the images see it {distance} m from its place (east {east}, north {north}, up {up} m), and contradict each other by {miss} px. If all points show the same offset, it is the vendor's pointing, which GCPS corrects; if one point differs, check its place and its marks.</source>
        <translation>Punkt {name}: Die Bilder sehen ihn {distance} m von seinem Ort entfernt (Ost {east}, Nord {north}, Höhe {up} m) und widersprechen einander um {miss} px. Zeigen alle Punkte denselben Versatz, ist es die Ausrichtung des Anbieters, die GCPS korrigiert; weicht ein Punkt ab, seinen Ort und seine Marken prüfen.</translation>
    </message>
    <message>
        <source>Point {name}: mark it in the image.</source>
        <translation>Punkt {name}: im Bild markieren.</translation>
    </message>
    <message>
        <source>Point {name}: the image shows it {distance} px from where the RPC has it. If all points show the same, it is the vendor's pointing, which GCPS of 'Export corrected RPCs' corrects; if one point differs, check its place and its mark.</source>
        <translation>Punkt {name}: Das Bild zeigt ihn {distance} px von dort entfernt, wo das RPC ihn hat. Gilt das für alle Punkte gleich, ist es die Ausrichtung des Anbieters, die GCPS von „Korrigierte RPC exportieren“ korrigiert; weicht ein Punkt ab, seinen Ort und seine Marke prüfen.</translation>
    </message>
    <message>
        <source>The measured points are not saved. Save them now? They stay here until QGIS closes.</source>
        <translation>Die gemessenen Punkte sind nicht gespeichert. Jetzt speichern? Sie bleiben hier, bis QGIS schließt.</translation>
    </message>
</context>
<context>
    <name>DsmFuse</name>
    <message>
        <source>Fuse heights into a DSM</source>
        <translation>Höhen zu einem DOM fusionieren</translation>
    </message>
    <message>
        <source>Makes one DSM from the height maps of all pairs, without outliers, and with its confidence.</source>
        <translation>Ein DOM aus den Höhenkarten aller Paare, ohne Ausreißer und mit seiner Konfidenz.</translation>
    </message>
</context>
<context>
    <name>Dtm</name>
    <message>
        <source>Find the terrain below houses and trees (DTM)</source>
        <translation>Gelände unter Häusern und Bäumen finden (DGM)</translation>
    </message>
    <message>
        <source>Bare earth from a DSM, with the heights of objects on it and a mask of objects.</source>
        <translation>Nackter Boden aus einem DOM, mit den Höhen der Objekte darauf und einer Maske der Objekte.</translation>
    </message>
    <message>
        <source>Scene (instead of the DSM)</source>
        <translation>Szene (anstelle des DOM)</translation>
    </message>
    <message>
        <source>DSM with houses and trees</source>
        <translation>DOM mit Häusern und Bäumen</translation>
    </message>
    <message>
        <source>A surface model of this plugin or of others, in a projected CRS; heights in metres.</source>
        <translation>Ein Oberflächenmodell dieses Plugins oder anderer Programme, in einem projizierten KBS; Höhen in Metern.</translation>
    </message>
    <message>
        <source>A reconstructed scene (reconstructed.json): it is fused to a DSM first, with its confidence.</source>
        <translation>Eine rekonstruierte Szene (reconstructed.json): Sie wird zuerst zu einem DOM fusioniert, mit seiner Konfidenz.</translation>
    </message>
    <message>
        <source>Confidence of the DSM</source>
        <translation>Konfidenz des DOM</translation>
    </message>
    <message>
        <source>The raster that was written with the DSM: heights that were interpolated do not count as ground, and those with a wide expected error count for less.</source>
        <translation>Das Raster, das mit dem DOM geschrieben wurde: Interpolierte Höhen zählen nicht als Boden, und solche mit großem erwartetem Fehler zählen weniger.</translation>
    </message>
    <message>
        <source>Largest object (m)</source>
        <translation>Größtes Objekt (m)</translation>
    </message>
    <message>
        <source>The width of the widest building, across its narrower side: wider objects count as ground. A smaller value takes less time.</source>
        <translation>Die Breite des breitesten Gebäudes, über seine schmalere Seite: Breitere Objekte gelten als Boden. Ein kleinerer Wert kostet weniger Zeit.</translation>
    </message>
    <message>
        <source>Steepest ground (%)</source>
        <translation>Steilster Boden (%)</translation>
    </message>
    <message>
        <source>An object has walls steeper than this around it. Choose more where hill tops are gone, such as 100 in mountains, and less where low buildings stay in the terrain.</source>
        <translation>Ein Objekt hat Wände um sich, die steiler sind als dieser Wert. Mehr wählen, wo Hügelkuppen fehlen, etwa 100 im Gebirge, und weniger, wo niedrige Gebäude im Gelände stehen bleiben.</translation>
    </message>
    <message>
        <source>Terrain where the DSM has no height</source>
        <translation>Gelände, wo das DOM keine Höhe hat</translation>
    </message>
    <message>
        <source>inside: where heights surround the void, and it is no wider than the largest object; none: nowhere.</source>
        <translation>inside: wo Höhen die Lücke umgeben und sie nicht breiter als das größte Objekt ist; none: nirgends.</translation>
    </message>
</context>
<context>
    <name>EditDsm</name>
    <message>
        <source>Apply edits to a DSM</source>
        <translation>Bearbeitungen auf ein DOM anwenden</translation>
    </message>
    <message>
        <source>Removes, fills or sets heights, flattens water and keeps breaklines, by the records of a GeoPackage.</source>
        <translation>Entfernt, füllt oder setzt Höhen, ebnet Wasser ein und hält Bruchkanten, nach den Einträgen eines GeoPackage.</translation>
    </message>
    <message>
        <source>DSM to edit</source>
        <translation>Zu bearbeitendes DOM</translation>
    </message>
    <message>
        <source>A surface model of this plugin or of others, in a projected CRS. It is not changed.</source>
        <translation>Ein Oberflächenmodell von diesem Plugin oder von anderen, in einem projizierten KBS. Es wird nicht verändert.</translation>
    </message>
    <message>
        <source>Edits</source>
        <translation>Bearbeitungen</translation>
    </message>
    <message>
        <source>A layer of polygons and lines with the fields number, operation (remove, fill, set, flatten or breakline), value and width in metres, and enabled. Plugins &gt; REPM &gt; Edit a DSM writes one.</source>
        <translation>Ein Layer mit Polygonen und Linien und den Feldern number, operation (remove, fill, set, flatten oder breakline), value und width in Metern und enabled. Erweiterungen &gt; REPM &gt; DOM bearbeiten schreibt einen.</translation>
    </message>
    <message>
        <source>Confidence of the DSM</source>
        <translation>Konfidenz des DOM</translation>
    </message>
    <message>
        <source>The raster that was written with the DSM. It is not changed.</source>
        <translation>Das Raster, das mit dem DOM geschrieben wurde. Es wird nicht verändert.</translation>
    </message>
</context>
<context>
    <name>Environment</name>
    <message>
        <source>Report the environment</source>
        <translation>Über die Umgebung berichten</translation>
    </message>
    <message>
        <source>Versions, missing packages and their installation, CUDA, memory, PROJ grids.</source>
        <translation>Versionen, fehlende Pakete und ihre Installation, CUDA, Speicher, Gitter von PROJ.</translation>
    </message>
    <message>
        <source>Install from a folder of wheels (without a network)</source>
        <translation>Aus einem Ordner mit Wheels installieren (ohne Netz)</translation>
    </message>
    <message>
        <source>Install what the engine needs, if it is missing</source>
        <translation>Installieren, was der Engine fehlt</translation>
    </message>
    <message>
        <source>Makes or renews the engine's own environment in your profile (about {download:.0f} MB to download, {disk:.0f} MB on the disk), through the proxy of QGIS's settings. QGIS itself is not changed.</source>
        <translation>Erstellt oder erneuert die eigene Umgebung der Engine in Ihrem Profil (etwa {download:.0f} MB herunterzuladen, {disk:.0f} MB auf der Platte), über den Proxy aus den Einstellungen von QGIS. QGIS selbst wird nicht verändert.</translation>
    </message>
    <message>
        <source>Files that end with .whl, for this Python and system. Empty: the Python Package Index.</source>
        <translation>Dateien mit der Endung .whl, für dieses Python und dieses System. Leer: der Python Package Index.</translation>
    </message>
    <message>
        <source>Remove the engine's environment</source>
        <translation>Umgebung der Engine entfernen</translation>
    </message>
    <message>
        <source>Do this before you uninstall the plugin, because QGIS removes the plugin's folder alone.</source>
        <translation>Vor der Deinstallation der Erweiterung ausführen, denn QGIS entfernt nur deren Ordner.</translation>
    </message>
    <message>
        <source>QGIS {version}</source>
        <translation>QGIS {version}</translation>
    </message>
    <message>
        <source>The engine does not run, so the report describes QGIS's own Python: {reason}</source>
        <translation>Die Engine läuft nicht, daher beschreibt der Bericht das Python von QGIS: {reason}</translation>
    </message>
</context>
<context>
    <name>EpmFit</name>
    <message>
        <source>Fit equivalent pinhole cameras</source>
        <translation>Äquivalente Lochkameras anpassen</translation>
    </message>
    <message>
        <source>Fits pinhole cameras to images with RPCs, tile by tile, and measures the error that this causes.</source>
        <translation>Passt Lochkameras an Bilder mit RPC an, Kachel für Kachel, und misst den Fehler, der dadurch entsteht.</translation>
    </message>
</context>
<context>
    <name>ErrorMap</name>
    <message>
        <source>Map the equivalent error</source>
        <translation>Äquivalenten Fehler kartieren</translation>
    </message>
    <message>
        <source>The error of the pinhole model in one view, as a raster on the ground.</source>
        <translation>Der Fehler des Lochkameramodells in einer Ansicht, als Raster am Boden.</translation>
    </message>
    <message>
        <source>View</source>
        <translation>Ansicht</translation>
    </message>
    <message>
        <source>A view's name as in the scene's report: its image file's name without extension.</source>
        <translation>Name einer Ansicht wie im Bericht der Szene: der Name ihrer Bilddatei ohne Endung.</translation>
    </message>
    <message>
        <source>Altitude (m)</source>
        <translation>Höhe (m)</translation>
    </message>
    <message>
        <source>Metres above the WGS 84 ellipsoid. Empty: the middle of the scene's range.</source>
        <translation>Meter über dem Ellipsoid WGS 84. Leer: die Mitte des Bereichs der Szene.</translation>
    </message>
</context>
<context>
    <name>ExportCameras</name>
    <message>
        <source>Export images with pinhole cameras</source>
        <translation>Bilder mit Lochkameras exportieren</translation>
    </message>
    <message>
        <source>Refined images with their cameras as COLMAP, MVSNet, WHU-TLC or nerfstudio read them.</source>
        <translation>Verfeinerte Bilder mit ihren Kameras, wie COLMAP, MVSNet, WHU-TLC oder nerfstudio sie lesen.</translation>
    </message>
    <message>
        <source>Refined scene</source>
        <translation>Verfeinerte Szene</translation>
    </message>
    <message>
        <source>Format</source>
        <translation>Format</translation>
    </message>
    <message>
        <source>colmap: PINHOLE cameras, binary and text; mvsnet: cam.txt and pair.txt; whutlc: WHU-TLC's pinhole layout for SatMVS, with square pixels; nerfstudio: transforms.json.</source>
        <translation>colmap: PINHOLE-Kameras, binär und als Text; mvsnet: cam.txt und pair.txt; whutlc: das Lochkameraformat von WHU-TLC für SatMVS, mit quadratischen Pixeln; nerfstudio: transforms.json.</translation>
    </message>
    <message>
        <source>Tile</source>
        <translation>Kachel</translation>
    </message>
    <message>
        <source>A tile's name as in the TILES layer; each tile is a model of its own.</source>
        <translation>Name einer Kachel wie im Layer TILES; jede Kachel ist ein eigenes Modell.</translation>
    </message>
    <message>
        <source>Turn the cameras towards their images</source>
        <translation>Kameras auf ihre Bilder drehen</translation>
    </message>
    <message>
        <source>On: principal points lie in the images' middle and pixels are square, as COLMAP's triangulation and software in single precision need it. Off: the refined images and cameras as they are in the scene.</source>
        <translation>An: Hauptpunkte liegen in der Bildmitte und Pixel sind quadratisch, wie es die Triangulation von COLMAP und Programme in einfacher Genauigkeit brauchen. Aus: verfeinerte Bilder und Kameras, wie sie in der Szene sind.</translation>
    </message>
    <message>
        <source>Bits of a pixel</source>
        <translation>Bit je Pixel</translation>
    </message>
    <message>
        <source>8: PNG (JPEG for mvsnet), intensity stretched as for matching; 16: TIFF with the images' own values, which fewer programs read.</source>
        <translation>8: PNG (JPEG für mvsnet), Helligkeit gestreckt wie für die Zuordnung; 16: TIFF mit den Werten der Bilder selbst, das weniger Programme lesen.</translation>
    </message>
</context>
<context>
    <name>ExportRpc</name>
    <message>
        <source>Export corrected RPCs</source>
        <translation>Korrigierte RPC exportieren</translation>
    </message>
    <message>
        <source>The RPC of each image with its pointing correction, as GDAL, OTB, CARS, S2P and ASP read it.</source>
        <translation>Das RPC jedes Bildes mit seiner Korrektur der Ausrichtung, wie GDAL, OTB, CARS, S2P und ASP es lesen.</translation>
    </message>
    <message>
        <source>Scene</source>
        <translation>Szene</translation>
    </message>
</context>
<context>
    <name>FirstSteps</name>
    <message>
        <source>REPM: first steps</source>
        <translation>REPM: erste Schritte</translation>
    </message>
    <message>
        <source>From satellite images to a surface model on the map, step by step:</source>
        <translation>Von Satellitenbildern zu einem Oberflächenmodell auf der Karte, Schritt für Schritt:</translation>
    </message>
    <message>
        <source>&lt;b&gt;First, install the engine's packages.&lt;/b&gt;&lt;br&gt;QGIS does not ship them.</source>
        <translation>&lt;b&gt;Zuerst die Pakete der Engine installieren.&lt;/b&gt;&lt;br&gt;QGIS liefert sie nicht mit.</translation>
    </message>
    <message>
        <source>Install the packages…</source>
        <translation>Pakete installieren…</translation>
    </message>
    <message>
        <source>&lt;b&gt;Make sample images.&lt;/b&gt;&lt;br&gt;Three simulated images of a town, with RPCs (some 10 s, 10 MB).</source>
        <translation>&lt;b&gt;Beispielbilder erzeugen.&lt;/b&gt;&lt;br&gt;Drei simulierte Bilder einer Stadt mit RPC (etwa 10 s, 10 MB).</translation>
    </message>
    <message>
        <source>Make the images…</source>
        <translation>Bilder erzeugen…</translation>
    </message>
    <message>
        <source>&lt;b&gt;Make a DSM of them.&lt;/b&gt;&lt;br&gt;The dialog is filled in: press Run (less than a minute).</source>
        <translation>&lt;b&gt;Daraus ein DOM erzeugen.&lt;/b&gt;&lt;br&gt;Der Dialog ist ausgefüllt: auf Starten klicken (weniger als eine Minute).</translation>
    </message>
    <message>
        <source>Make the DSM…</source>
        <translation>DOM erzeugen…</translation>
    </message>
    <message>
        <source>&lt;b&gt;Read the tutorial.&lt;/b&gt;&lt;br&gt;From the order of images to a DSM that you can defend.</source>
        <translation>&lt;b&gt;Die Anleitung lesen.&lt;/b&gt;&lt;br&gt;Von der Bestellung der Bilder zu einem DOM, das sich vertreten lässt.</translation>
    </message>
    <message>
        <source>Open the tutorial</source>
        <translation>Anleitung öffnen</translation>
    </message>
    <message>
        <source>You find these steps again in the menu Plugins &gt; REPM.</source>
        <translation>Diese Schritte stehen auch im Menü Erweiterungen &gt; REPM.</translation>
    </message>
    <message>
        <source>Make the sample images first.</source>
        <translation>Erst die Beispielbilder erzeugen.</translation>
    </message>
    <message>
        <source>sample images</source>
        <translation>Beispielbilder</translation>
    </message>
    <message>
        <source>sample town</source>
        <translation>Beispielstadt</translation>
    </message>
</context>
<context>
    <name>GeoidGridsDialog</name>
    <message>
        <source>REPM: geoid grids</source>
        <translation>REPM: Geoidgitter</translation>
    </message>
    <message>
        <source>Heights above a geoid, as most maps have them, are brought to the ellipsoid with a grid. QGIS ships few of them. They are fetched from PROJ's network into your profile, and can be used at once.</source>
        <translation>Höhen über einem Geoid, wie die meisten Karten sie haben, werden mit einem Gitter auf das Ellipsoid bezogen. QGIS bringt nur wenige mit. Sie werden aus dem Netz von PROJ in Ihr Profil geholt und sind sofort nutzbar.</translation>
    </message>
    <message>
        <source>Another vertical datum, such as EPSG:5709</source>
        <translation>Ein anderer Höhenbezug, etwa EPSG:5709</translation>
    </message>
    <message>
        <source>Look up</source>
        <translation>Nachschlagen</translation>
    </message>
    <message>
        <source>Copernicus DEM, most vendors' heights above sea level</source>
        <translation>Copernicus-DEM, bei den meisten Anbietern die Höhen über dem Meeresspiegel</translation>
    </message>
    <message>
        <source>SRTM, older products</source>
        <translation>SRTM, ältere Produkte</translation>
    </message>
    <message>
        <source>PROJ {version} knows no grid for '{datum}'.</source>
        <translation>PROJ {version} kennt kein Gitter für „{datum}“.</translation>
    </message>
    <message>
        <source>Installed</source>
        <translation>Vorhanden</translation>
    </message>
    <message>
        <source>Fetch</source>
        <translation>Holen</translation>
    </message>
    <message>
        <source>Fetching {name}…</source>
        <translation>{name} wird geholt…</translation>
    </message>
    <message>
        <source>Check the network, and the proxy under Settings &gt; Options &gt; Network.</source>
        <translation>Das Netzwerk prüfen, und den Proxy unter Einstellungen &gt; Optionen &gt; Netzwerk.</translation>
    </message>
    <message>
        <source>The grid could not be fetched: {error}</source>
        <translation>Das Gitter konnte nicht geholt werden: {error}</translation>
    </message>
    <message>
        <source>{name} is installed: heights above this geoid can be used now.</source>
        <translation>{name} ist installiert: Höhen über diesem Geoid sind jetzt nutzbar.</translation>
    </message>
</context>
<context>
    <name>Hillshades</name>
    <message>
        <source>Hillshade</source>
        <translation>Schummerung</translation>
    </message>
    <message>
        <source>Hillshade of {name}</source>
        <translation>Schummerung von {name}</translation>
    </message>
</context>
<context>
    <name>Inspect</name>
    <message>
        <source>Inspect images</source>
        <translation>Bilder prüfen</translation>
    </message>
    <message>
        <source>Footprints, overlaps, and the pairs that are worth matching: in seconds, before any matching.</source>
        <translation>Bildflächen, Überlappungen und lohnende Bildpaare: in Sekunden, noch vor jeder Bildzuordnung.</translation>
    </message>
</context>
<context>
    <name>MapModel</name>
    <message>
        <source>Make map layers of a DSM (model)</source>
        <translation>Kartenlayer aus einem DOM erzeugen (Modell)</translation>
    </message>
</context>
<context>
    <name>Mosaic</name>
    <message>
        <source>Make a mosaic of DSMs</source>
        <translation>Mosaik aus DOM erzeugen</translation>
    </message>
    <message>
        <source>One DSM from many that overlap: without vertical offsets between them, and without visible seams.</source>
        <translation>Ein DOM aus vielen, die sich überlappen: ohne Höhenversätze zwischen ihnen und ohne sichtbare Nähte.</translation>
    </message>
    <message>
        <source>DSMs</source>
        <translation>DOM</translation>
    </message>
    <message>
        <source>DSMs of this plugin or of others, in any CRS, with heights of one datum. Two or more, together with the scenes.</source>
        <translation>DOM dieser Erweiterung oder anderer Programme, in beliebigem KBS, mit einem gemeinsamen Höhenbezug. Zusammen mit den Szenen mindestens zwei.</translation>
    </message>
    <message>
        <source>Scenes</source>
        <translation>Szenen</translation>
    </message>
    <message>
        <source>Reconstructed scenes (reconstructed.json or registered.json): each is fused to a DSM first. Heights of a scene that was registered, or has ground control points, stay as they are.</source>
        <translation>Rekonstruierte Szenen (reconstructed.json oder registered.json): Jede wird zuerst zu einem DOM fusioniert. Die Höhen einer Szene, die eingepasst wurde oder Passpunkte hat, bleiben, wie sie sind.</translation>
    </message>
    <message>
        <source>DSMs or scenes whose heights are right</source>
        <translation>DOM oder Szenen, deren Höhen richtig sind</translation>
    </message>
    <message>
        <source>Their heights stay, and all others are brought to them. Scenes that were registered, or have ground control points, and DSMs of such scenes are included automatically. Where there is none, the mean of all offsets is zero.</source>
        <translation>Ihre Höhen bleiben, und alle anderen werden an sie angeglichen. Szenen, die eingepasst wurden oder Passpunkte haben, und DOM solcher Szenen sind automatisch dabei. Ohne solche ist das Mittel aller Versätze null.</translation>
    </message>
    <message>
        <source>Resolution (m)</source>
        <translation>Auflösung (m)</translation>
    </message>
    <message>
        <source>Cell size in units of the CRS. 0: the first DSM's.</source>
        <translation>Zellgröße in Einheiten des KBS. 0: die des ersten DOM.</translation>
    </message>
    <message>
        <source>CRS of the mosaic</source>
        <translation>KBS des Mosaiks</translation>
    </message>
    <message>
        <source>A projected CRS. Empty: the first DSM's.</source>
        <translation>Ein projiziertes KBS. Leer: das des ersten DOM.</translation>
    </message>
    <message>
        <source>The better of two heights counts for more. Empty: all heights count equally.</source>
        <translation>Die bessere von zwei Höhen zählt mehr. Leer: Alle Höhen zählen gleich.</translation>
    </message>
</context>
<context>
    <name>Panel</name>
    <message>
        <source>Choose from a list</source>
        <translation>Aus einer Liste wählen</translation>
    </message>
    <message>
        <source>Choose a scene first</source>
        <translation>Zuerst eine Szene wählen</translation>
    </message>
    <message>
        <source>[Save in {folder}]</source>
        <translation>[In {folder} speichern]</translation>
    </message>
</context>
<context>
    <name>Pipeline</name>
    <message>
        <source>Make a DSM from satellite images</source>
        <translation>DOM aus Satellitenbildern erzeugen</translation>
    </message>
    <message>
        <source>All stages in one run: pinhole cameras, refinement, tie points, dense matching, fusion.</source>
        <translation>Alle Stufen in einem Lauf: Lochkameras, Verfeinerung, Verknüpfungspunkte, dichte Zuordnung, Fusion.</translation>
    </message>
</context>
<context>
    <name>PluginMenu</name>
    <message>
        <source>First steps</source>
        <translation>Erste Schritte</translation>
    </message>
    <message>
        <source>Inspect images…</source>
        <translation>Bilder prüfen…</translation>
    </message>
    <message>
        <source>Make a DSM…</source>
        <translation>DOM erzeugen…</translation>
    </message>
    <message>
        <source>Scenes</source>
        <translation>Szenen</translation>
    </message>
    <message>
        <source>Measure control points…</source>
        <translation>Passpunkte messen…</translation>
    </message>
    <message>
        <source>Edit a DSM…</source>
        <translation>DOM bearbeiten…</translation>
    </message>
    <message>
        <source>Install the engine's packages…</source>
        <translation>Pakete der Engine installieren…</translation>
    </message>
    <message>
        <source>Geoid grids…</source>
        <translation>Geoidgitter…</translation>
    </message>
    <message>
        <source>Tutorial</source>
        <translation>Anleitung zum Einstieg</translation>
    </message>
    <message>
        <source>Help</source>
        <translation>Hilfe</translation>
    </message>
</context>
<context>
    <name>PointTable</name>
    <message>
        <source>Point</source>
        <translation>Punkt</translation>
    </message>
    <message>
        <source>Images</source>
        <translation>Bilder</translation>
    </message>
    <message>
        <source>Offset (m)</source>
        <translation>Versatz (m)</translation>
    </message>
    <message>
        <source>Miss (px)</source>
        <translation>Abweichung (px)</translation>
    </message>
    <message>
        <source>Check only</source>
        <translation>Nur Kontrolle</translation>
    </message>
    <message>
        <source>Height (m)</source>
        <translation>Höhe (m)</translation>
    </message>
    <message>
        <source>Longitude (°)</source>
        <translation>Länge (°)</translation>
    </message>
    <message>
        <source>Latitude (°)</source>
        <translation>Breite (°)</translation>
    </message>
</context>
<context>
    <name>Reconstruct</name>
    <message>
        <source>Reconstruct heights</source>
        <translation>Höhen rekonstruieren</translation>
    </message>
    <message>
        <source>Tie points and relative pointing of the views, then a height map of every pair and tile.</source>
        <translation>Verknüpfungspunkte und relative Ausrichtung der Ansichten, dann eine Höhenkarte je Paar und Kachel.</translation>
    </message>
</context>
<context>
    <name>Refine</name>
    <message>
        <source>Refine the images</source>
        <translation>Bilder verfeinern</translation>
    </message>
    <message>
        <source>Resamples every view's tiles to what its pinhole camera would have seen.</source>
        <translation>Rechnet die Kacheln jeder Ansicht auf das um, was ihre Lochkamera gesehen hätte.</translation>
    </message>
</context>
<context>
    <name>Register</name>
    <message>
        <source>Register to a reference</source>
        <translation>Auf eine Referenz einpassen</translation>
    </message>
    <message>
        <source>Moves a scene onto a DEM, lidar or other known heights by correcting the pointing of its images.</source>
        <translation>Verschiebt eine Szene auf ein Höhenmodell, Lidar oder andere bekannte Höhen, indem die Ausrichtung ihrer Bilder korrigiert wird.</translation>
    </message>
    <message>
        <source>Correction</source>
        <translation>Korrektur</translation>
    </message>
    <message>
        <source>shift: a shift in three dimensions; tilt: also a tilt, where the heights determine one.</source>
        <translation>shift: eine Verschiebung in drei Dimensionen; tilt: auch eine Neigung, wo die Höhen sie bestimmen.</translation>
    </message>
    <message>
        <source>Other scenes that overlap</source>
        <translation>Weitere Szenen, die sich überlappen</translation>
    </message>
    <message>
        <source>Reconstructed scenes of the same strip or mosaic: all are placed together, so that no step is left between their DSMs. Each is written beside its own file (..._registered.json).</source>
        <translation>Rekonstruierte Szenen desselben Streifens oder Mosaiks: Alle werden gemeinsam eingepasst, sodass keine Stufe zwischen ihren DOM bleibt. Jede wird neben ihre eigene Datei geschrieben (..._registered.json).</translation>
    </message>
</context>
<context>
    <name>RepmAlgorithm</name>
    <message>
        <source>Preparation</source>
        <translation>Vorbereitung</translation>
    </message>
    <message>
        <source>Images to DSM</source>
        <translation>Bilder zu DOM</translation>
    </message>
    <message>
        <source>Evaluation</source>
        <translation>Bewertung</translation>
    </message>
    <message>
        <source>Edits and terrain</source>
        <translation>Korrekturen und Gelände</translation>
    </message>
    <message>
        <source>Mosaic</source>
        <translation>Mosaik</translation>
    </message>
    <message>
        <source>Stage by stage: pinhole cameras</source>
        <translation>Stufe für Stufe: Lochkameras</translation>
    </message>
    <message>
        <source>Stage by stage: surface</source>
        <translation>Stufe für Stufe: Oberfläche</translation>
    </message>
    <message>
        <source>The layer '{layer}' of {name} comes from '{provider}': choose raster files, only they have RPCs.</source>
        <translation>Der Layer „{layer}“ in {name} kommt von „{provider}“: Rasterdateien wählen, nur sie haben RPC.</translation>
    </message>
    <message>
        <source>BACKEND is '{name}', which {remedy}; or choose auto.</source>
        <translation>BACKEND „{name}“ {remedy}; sonst auto wählen.</translation>
    </message>
    <message>
        <source>{name} '{path}' is not there: check its path.</source>
        <translation>{name} „{path}“ ist nicht da: den Pfad prüfen.</translation>
    </message>
    <message>
        <source>{name} '{path}' is not a scene: choose the scene.json that the previous stage wrote.</source>
        <translation>{name} „{path}“ ist keine Szene: die scene.json wählen, die die vorige Stufe geschrieben hat.</translation>
    </message>
    <message>
        <source>The layer '{layer}' of {name} is a raster: choose a vector layer or a table.</source>
        <translation>Der Layer „{layer}“ in {name} ist ein Raster: einen Vektorlayer oder eine Tabelle wählen.</translation>
    </message>
    <message>
        <source>{name} '{path}' cannot be read as a raster: check that the file is complete.</source>
        <translation>{name} „{path}“ ist nicht als Raster lesbar: prüfen, ob die Datei vollständig ist.</translation>
    </message>
    <message>
        <source>{name} is not a parameter of {id} and has no effect: do you mean {near}?</source>
        <translation>{name} ist kein Parameter von {id} und bewirkt nichts: ist {near} gemeint?</translation>
    </message>
    <message>
        <source>Seconds: {stages}</source>
        <translation>Sekunden: {stages}</translation>
    </message>
    <message>
        <source>The page in English, with all details</source>
        <translation>Die englische Seite, mit allen Einzelheiten</translation>
    </message>
    <message>
        <source>Further parameters</source>
        <translation>Weitere Parameter</translation>
    </message>
    <message>
        <source>Parameters</source>
        <translation>Parameter</translation>
    </message>
</context>
<context>
    <name>RepmInstall</name>
    <message>
        <source>Python packages that REPM needs are missing.</source>
        <translation>Es fehlen Python-Pakete, die REPM braucht.</translation>
    </message>
    <message>
        <source>REPM now needs other Python packages than before.</source>
        <translation>REPM braucht jetzt andere Python-Pakete als vorher.</translation>
    </message>
    <message>
        <source>Install the packages…</source>
        <translation>Pakete installieren…</translation>
    </message>
    <message>
        <source>The installation was cancelled.</source>
        <translation>Die Installation wurde abgebrochen.</translation>
    </message>
    <message>
        <source>You have chosen {python} as the engine's interpreter; its packages are not checked here. To use the packages of this dialog, clear it in Settings &gt; Options &gt; Processing &gt; Providers &gt; REPM (or the variable REPM_ENGINE_PYTHON).</source>
        <translation>Sie haben {python} als Interpreter der Engine gewählt; seine Pakete werden hier nicht geprüft. Um die Pakete dieses Dialogs zu verwenden, leeren Sie ihn unter Einstellungen &gt; Optionen &gt; Verarbeitung &gt; Datenanbieter &gt; REPM (oder in der Variablen REPM_ENGINE_PYTHON).</translation>
    </message>
    <message>
        <source>The engine has all packages that it needs. Nothing has to be done.</source>
        <translation>Die Engine hat alle Pakete, die sie braucht. Es ist nichts zu tun.</translation>
    </message>
    <message>
        <source>REPM's engine needs these packages, which QGIS does not ship. They get an environment of their own in your profile: QGIS itself is not changed, and an update of REPM finds them again.</source>
        <translation>Die Engine von REPM braucht diese Pakete, die QGIS nicht mitliefert. Sie bekommen eine eigene Umgebung in Ihrem Profil: QGIS selbst wird nicht verändert, und eine neue Version von REPM findet sie wieder.</translation>
    </message>
    <message>
        <source>This version of REPM needs other packages than the earlier one: install again.</source>
        <translation>Diese Version von REPM braucht andere Pakete als die vorige: bitte neu installieren.</translation>
    </message>
    <message>
        <source>REPM: install the engine's packages</source>
        <translation>REPM: Pakete der Engine installieren</translation>
    </message>
    <message>
        <source>Package</source>
        <translation>Paket</translation>
    </message>
    <message>
        <source>For</source>
        <translation>Für</translation>
    </message>
    <message>
        <source>Download (MB)</source>
        <translation>Herunterladen (MB)</translation>
    </message>
    <message>
        <source>Disk (MB)</source>
        <translation>Platte (MB)</translation>
    </message>
    <message>
        <source>empty: from the Python Package Index</source>
        <translation>leer: vom Python Package Index</translation>
    </message>
    <message>
        <source>Proxy (empty: none, or the system's)</source>
        <translation>Proxy (leer: keiner oder der des Systems)</translation>
    </message>
    <message>
        <source>Folder of wheels (without a network)</source>
        <translation>Ordner mit Wheels (ohne Netz)</translation>
    </message>
    <message>
        <source>Install</source>
        <translation>Installieren</translation>
    </message>
    <message>
        <source>Cancel</source>
        <translation>Abbrechen</translation>
    </message>
    <message>
        <source>Remove the environment</source>
        <translation>Umgebung entfernen</translation>
    </message>
    <message>
        <source>Open the log</source>
        <translation>Protokoll öffnen</translation>
    </message>
    <message>
        <source>Close</source>
        <translation>Schließen</translation>
    </message>
    <message>
        <source>To download: about {download:.0f} MB. On the disk: about {disk:.0f} MB in {folder} ({free} MB are free there). Python: {python}</source>
        <translation>Herunterzuladen: etwa {download:.0f} MB. Auf der Platte: etwa {disk:.0f} MB in {folder} (dort sind {free} MB frei). Python: {python}</translation>
    </message>
    <message>
        <source>Install REPM's packages</source>
        <translation>Pakete von REPM installieren</translation>
    </message>
    <message>
        <source>Cancelling…</source>
        <translation>Wird abgebrochen…</translation>
    </message>
    <message>
        <source>The packages are installed: every algorithm of REPM can run now.</source>
        <translation>Die Pakete sind installiert: Jetzt läuft jeder Algorithmus von REPM.</translation>
    </message>
    <message>
        <source>Remove the engine's environment? Do this before you uninstall REPM; it can be installed again.</source>
        <translation>Umgebung der Engine entfernen? Tun Sie das, bevor Sie REPM deinstallieren; sie lässt sich wieder installieren.</translation>
    </message>
</context>
<context>
    <name>RepmModelCopy</name>
    <message>
        <source>Copy to my models and edit…</source>
        <translation>In meine Modelle kopieren und bearbeiten …</translation>
    </message>
    <message>
        <source>The model cannot be written to '{path}': check that you may write there.</source>
        <translation>Das Modell kann nicht nach „{path}“ geschrieben werden: prüfen, ob dort geschrieben werden darf.</translation>
    </message>
</context>
<context>
    <name>RepmNextStep</name>
    <message>
        <source>DSM of the best pair…</source>
        <translation>DOM aus dem besten Paar…</translation>
    </message>
    <message>
        <source>DSM of the best triplet…</source>
        <translation>DOM aus dem besten Tripel…</translation>
    </message>
    <message>
        <source>The images are inspected.</source>
        <translation>Die Bilder sind geprüft.</translation>
    </message>
    <message>
        <source>The preview is on the map.</source>
        <translation>Die Vorschau liegt auf der Karte.</translation>
    </message>
    <message>
        <source>The preview is on the map: altitudes {low} to {high} m for the DSM.</source>
        <translation>Die Vorschau liegt auf der Karte: Höhen {low} bis {high} m für das DOM.</translation>
    </message>
    <message>
        <source>Draw the area on it…</source>
        <translation>Gebiet darauf zeichnen…</translation>
    </message>
    <message>
        <source>Make the DSM…</source>
        <translation>DOM erzeugen…</translation>
    </message>
    <message>
        <source>Is the DSM in the right place?</source>
        <translation>Stimmt die Lage des DOM?</translation>
    </message>
    <message>
        <source>Is the DSM in the right place now?</source>
        <translation>Stimmt die Lage jetzt?</translation>
    </message>
    <message>
        <source>Is the DSM wrong somewhere? Edit it.</source>
        <translation>Ist das DOM irgendwo falsch? Bearbeiten.</translation>
    </message>
    <message>
        <source>Is the DSM off by too much? Register its scene.</source>
        <translation>Liegt das DOM zu weit daneben? Seine Szene einpassen.</translation>
    </message>
    <message>
        <source>Register to this reference…</source>
        <translation>Auf diese Referenz einpassen…</translation>
    </message>
    <message>
        <source>The scene was moved by {distance} m.</source>
        <translation>Die Szene wurde um {distance} m verschoben.</translation>
    </message>
    <message>
        <source>Before</source>
        <translation>Vorher</translation>
    </message>
    <message>
        <source>After</source>
        <translation>Nachher</translation>
    </message>
    <message>
        <source>Make the DSM again…</source>
        <translation>DOM neu erzeugen…</translation>
    </message>
    <message>
        <source>Compare with a reference…</source>
        <translation>Mit einer Referenz vergleichen…</translation>
    </message>
    <message>
        <source>Register to a reference…</source>
        <translation>Auf eine Referenz einpassen…</translation>
    </message>
    <message>
        <source>Edit the DSM…</source>
        <translation>DOM bearbeiten…</translation>
    </message>
</context>
<context>
    <name>RepmParameters</name>
    <message>
        <source>Images and products</source>
        <translation>Bilder und Produkte</translation>
    </message>
    <message>
        <source>Images</source>
        <translation>Bilder</translation>
    </message>
    <message>
        <source>Products in tiles, archives and STAC items</source>
        <translation>Produkte in Kacheln, Archive und STAC-Items</translation>
    </message>
    <message>
        <source>All files</source>
        <translation>Alle Dateien</translation>
    </message>
    <message>
        <source>Satellite images with RPCs</source>
        <translation>Satellitenbilder mit RPC</translation>
    </message>
    <message>
        <source>Two or more images of the same ground in sensor geometry (level Basic, Sensor or Primary), or ortho-ready, each with its RPC in the file or beside it. A tile stands for its whole image, and the path of a folder, a ZIP or TAR file or a STAC item, as it was delivered, for the images in it.</source>
        <translation>Zwei oder mehr Bilder desselben Bodens in Sensorgeometrie (Stufe Basic, Sensor oder Primary) oder „ortho-ready“, jedes mit seinem RPC in der Datei oder daneben. Eine Kachel steht für ihr ganzes Bild, und der Pfad eines Ordners, einer ZIP- oder TAR-Datei oder eines STAC-Eintrags, wie geliefert, für die Bilder darin.</translation>
    </message>
    <message>
        <source>One image alone has a camera, but no heights.</source>
        <translation>Ein Bild allein hat eine Kamera, aber keine Höhen.</translation>
    </message>
    <message>
        <source>RPC files</source>
        <translation>RPC-Dateien</translation>
    </message>
    <message>
        <source>Only needed where the RPCs are neither in the images nor beside them: one file for each image, in the order of the images.</source>
        <translation>Nur nötig, wo die RPC weder in den Bildern noch daneben liegen: eine Datei je Bild, in der Reihenfolge der Bilder.</translation>
    </message>
    <message>
        <source>Masks of pixels that must not be used</source>
        <translation>Masken unbrauchbarer Pixel</translation>
    </message>
    <message>
        <source>One raster for each image, in the order of the images and of the same size in columns and rows: pixels that are neither zero nor nodata (clouds, water) are not used at all, not even for tie points. The image's own mask or alpha band is always used.</source>
        <translation>Ein Raster je Bild, in der Reihenfolge der Bilder und gleich groß in Spalten und Zeilen: Pixel, die weder null noch NoData sind (Wolken, Wasser), werden gar nicht verwendet, auch nicht für Verknüpfungspunkte. Die eigene Maske oder der Alphakanal eines Bildes gilt immer.</translation>
    </message>
    <message>
        <source>One raster for each DSM, in the order of the DSMs: this plugin's confidence raster, or one band with the expected error in metres.</source>
        <translation>Ein Raster für jedes DOM, in der Reihenfolge der DOM: das Konfidenzraster dieser Erweiterung oder ein Kanal mit dem erwarteten Fehler in Metern.</translation>
    </message>
    <message>
        <source>Confidence rasters</source>
        <translation>Konfidenzraster</translation>
    </message>
    <message>
        <source>Ground control points</source>
        <translation>Passpunkte</translation>
    </message>
    <message>
        <source>A CSV file or point layer with one row for each point and image: id, lon, lat, height, view (the image's file name), col, row (the first pixel's centre is 0, 0), role (control or check). The geometry of a layer can replace lon and lat.</source>
        <translation>Eine CSV-Datei oder ein Punktlayer mit einer Zeile je Punkt und Bild: id, lon, lat, height, view (Dateiname des Bildes), col, row (die Mitte des ersten Pixels ist 0, 0), role (control oder check). Die Geometrie eines Layers kann lon und lat ersetzen.</translation>
    </message>
    <message>
        <source>References</source>
        <translation>Referenzen</translation>
    </message>
    <message>
        <source>Known heights: a DEM such as Copernicus GLO-30 or SRTM, a lidar DEM or cloud (LAZ), an older DSM, points (CSV, GeoPackage), or ICESat-2 and GEDI (HDF5, CSV). The whole scene is moved onto them.</source>
        <translation>Bekannte Höhen: ein DEM wie Copernicus GLO-30 oder SRTM, ein DEM oder eine Punktwolke aus Lidar (LAZ), ein älteres DOM, Punkte (CSV, GeoPackage) oder ICESat-2 und GEDI (HDF5, CSV). Die ganze Szene wird auf sie verschoben.</translation>
    </message>
    <message>
        <source>Heights of the references refer to</source>
        <translation>Höhen der Referenzen beziehen sich auf</translation>
    </message>
    <message>
        <source>auto: what each file says, or else the datum that fits; the log names it. Or give ellipsoid, EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773.</source>
        <translation>auto: was jede Datei angibt, sonst der Höhenbezug, der passt; das Protokoll nennt ihn. Oder ellipsoid, EGM96, EGM2008 oder jedes Höhen-KBS angeben, das PROJ kennt, etwa EPSG:5773.</translation>
    </message>
    <message>
        <source>Ground that has not changed</source>
        <translation>Gelände, das sich nicht verändert hat</translation>
    </message>
    <message>
        <source>Polygons, or a raster that is not zero on such ground: only heights there count. Empty: all heights count.</source>
        <translation>Polygone oder ein Raster, das auf solchem Gelände nicht null ist: Nur Höhen dort zählen. Leer: Alle Höhen zählen.</translation>
    </message>
    <message>
        <source>Dask cluster</source>
        <translation>Dask-Cluster</translation>
    </message>
    <message>
        <source>The address of a Dask scheduler, such as tcp://10.0.0.1:8786, or its scheduler file: the work is done by the cluster's workers. They must see the images, the workspace and the products under the same paths. Empty: the cluster of the settings, or this machine where there is none.</source>
        <translation>Die Adresse eines Dask-Schedulers wie tcp://10.0.0.1:8786 oder seine Scheduler-Datei: Die Arbeit tun die Prozesse des Clusters. Sie müssen die Bilder, den Arbeitsordner und die Produkte unter denselben Pfaden sehen. Leer: der Cluster der Einstellungen, oder dieser Rechner, wenn dort keiner steht.</translation>
    </message>
    <message>
        <source>Heights of the control points refer to</source>
        <translation>Höhenbezug der Passpunkte</translation>
    </message>
    <message>
        <source>EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773. Its grid must be installed: the Environment report names what is missing.</source>
        <translation>EGM96, EGM2008 oder jedes Höhen-KBS, das PROJ kennt, etwa EPSG:5773. Sein Gitter muss installiert sein: Der Umgebungsbericht nennt, was fehlt.</translation>
    </message>
    <message>
        <source>Heights refer to</source>
        <translation>Höhen beziehen sich auf</translation>
    </message>
    <message>
        <source>EGM96, EGM2008, or any vertical CRS that PROJ knows, such as EPSG:5773; it is written into the DSM's CRS. Its grid must be installed: without it the run stops, and names the grid.</source>
        <translation>EGM96, EGM2008 oder jedes Höhen-KBS, das PROJ kennt, etwa EPSG:5773; es steht dann im KBS des DOM. Sein Gitter muss installiert sein: Ohne es hält der Lauf an und nennt das Gitter.</translation>
    </message>
    <message>
        <source>Pointing correction</source>
        <translation>Korrektur der Ausrichtung</translation>
    </message>
    <message>
        <source>What is corrected in each image. shift: one shift; affine: also scale, shear and rotation; jitter: also waves of its lines, because the satellite shook; auto: affine where the tie points show a trend and span the images well enough, and jitter where they show waves.</source>
        <translation>Was in jedem Bild korrigiert wird. shift: eine Verschiebung; affine: auch Maßstab, Scherung und Drehung; jitter: auch Wellen seiner Zeilen, weil der Satellit gezittert hat; auto: affine, wo die Verknüpfungspunkte einen Trend zeigen und die Bilder gut genug abdecken, und jitter, wo sie Wellen zeigen.</translation>
    </message>
    <message>
        <source>Quality of the matching</source>
        <translation>Qualität der Zuordnung</translation>
    </message>
    <message>
        <source>fast: only as many pairs as connect all images, a fifth to a third less time, and more gaps; best: semi-global matching in eight directions instead of three, up to half more time and more memory, for mountains, low suns and oblique views; default: between the two.</source>
        <translation>fast: nur so viele Paare, wie alle Bilder verbinden, ein Fünftel bis ein Drittel weniger Zeit und mehr Lücken; best: semiglobale Zuordnung in acht Richtungen statt drei, bis zur Hälfte mehr Zeit und mehr Speicher, für Gebirge, tiefe Sonnenstände und schräge Ansichten; default: dazwischen.</translation>
    </message>
    <message>
        <source>Matching cost</source>
        <translation>Kosten der Zuordnung</translation>
    </message>
    <message>
        <source>What tells that two pixels show the same place. intensity: the images' grey values, for images of one day; learned: features of a small neural network, for images of different seasons, which takes up to twice the time; auto: decided for each pair by how well its images agree.</source>
        <translation>Woran man erkennt, dass zwei Pixel denselben Ort zeigen. intensity: an den Grauwerten der Bilder, für Bilder eines Tages; learned: an Merkmalen eines kleinen neuronalen Netzes, für Bilder verschiedener Jahreszeiten, was bis zu doppelt so lange dauert; auto: für jedes Paar danach entschieden, wie gut seine Bilder übereinstimmen.</translation>
    </message>
    <message>
        <source>Pairs of images</source>
        <translation>Bildpaare</translation>
    </message>
    <message>
        <source>best: all pairs of up to three images, and the two best ones of each of more images; fewest: only as many as connect all images, which takes less time and leaves more gaps.</source>
        <translation>best: alle Paare von bis zu drei Bildern, bei mehr Bildern die zwei besten jedes Bildes; fewest: nur so viele, dass sie alle Bilder verbinden, was weniger Zeit kostet und mehr Lücken lässt.</translation>
    </message>
    <message>
        <source>Adjustment that finds the pointing correction</source>
        <translation>Ausgleichung, die die Korrektur der Ausrichtung findet</translation>
    </message>
    <message>
        <source>rpc: against the original RPCs, exact, with control points and affine corrections; colmap: as in the paper, COLMAP moves the principal points of the pinhole cameras: shifts only, and no control points.</source>
        <translation>rpc: gegen die ursprünglichen RPC, exakt, mit Passpunkten und affinen Korrekturen; colmap: wie in der Veröffentlichung verschiebt COLMAP die Bildhauptpunkte der Lochkameras: nur Verschiebungen und keine Passpunkte.</translation>
    </message>
    <message>
        <source>Preset</source>
        <translation>Voreinstellung</translation>
    </message>
    <message>
        <source>Values that go together, for advanced parameters below; the dialog fills them in, and you can change each of them afterwards. city: walls and streets; mountains: a surface without holes; fast: a first look, of the fewest pairs; preview: reduced images, in seconds. In a command, a value that you give overrides the preset's.</source>
        <translation>Werte, die zusammengehören, für erweiterte Parameter weiter unten; der Dialog trägt sie ein, und jeder kann danach geändert werden. city: Wände und Straßen; mountains: eine Oberfläche ohne Lücken; fast: ein erster Blick, mit den wenigsten Paaren; preview: verkleinerte Bilder, in Sekunden. In einem Befehl geht ein angegebener Wert dem der Voreinstellung vor.</translation>
    </message>
    <message>
        <source>Area</source>
        <translation>Gebiet</translation>
    </message>
    <message>
        <source>Only this area is computed. Empty: all that two images see.</source>
        <translation>Nur dieses Gebiet wird berechnet. Leer: alles, was zwei Bilder sehen.</translation>
    </message>
    <message>
        <source>Coarse elevation model</source>
        <translation>Grobes Höhenmodell</translation>
    </message>
    <message>
        <source>Any DEM that covers the area: it narrows the range of altitudes, and is the surface of the terrain model. Heights above the ellipsoid or, where its CRS says so, above the geoid.</source>
        <translation>Ein beliebiges DEM, das das Gebiet abdeckt: es engt den Höhenbereich ein und ist die Oberfläche des Modells terrain. Höhen über dem Ellipsoid oder, wo sein KBS das sagt, über dem Geoid.</translation>
    </message>
    <message>
        <source>Only for the terrain model, which refines on this surface; a DEM with cells of 30 m is fine enough. Empty: the heights that the scene already has from 'Reconstruct heights'.</source>
        <translation>Nur für das Geländemodell, das auf dieser Oberfläche verfeinert; ein DEM mit 30-m-Zellen ist fein genug. Leer: die Höhen, die die Szene aus „Höhen rekonstruieren“ schon hat.</translation>
    </message>
    <message>
        <source>Metres above the WGS 84 ellipsoid. Empty: from the DEM, else from the images or the RPCs.</source>
        <translation>Meter über dem Ellipsoid WGS 84. Leer: aus dem DEM, sonst aus den Bildern oder den RPC.</translation>
    </message>
    <message>
        <source>Lowest altitude (m)</source>
        <translation>Niedrigste Höhe (m)</translation>
    </message>
    <message>
        <source>Highest altitude (m)</source>
        <translation>Größte Höhe (m)</translation>
    </message>
    <message>
        <source>Height of ortho-ready images (m)</source>
        <translation>Höhe der Bilder „ortho-ready“ (m)</translation>
    </message>
    <message>
        <source>The height above the WGS 84 ellipsoid to which ortho-ready images were projected (Maxar OR2A, Airbus projected, GF and ZY 2A), where their metadata do not state it. Empty: it is found with a DEM, or else the middle of the RPC's heights is assumed, and the log says so. Images in sensor geometry do not need it.</source>
        <translation>Die Höhe über dem Ellipsoid WGS 84, auf die Bilder „ortho-ready“ projiziert wurden (Maxar OR2A, Airbus projected, GF und ZY 2A), wenn ihre Metadaten sie nicht nennen. Leer: Sie wird mit einem DEM gefunden, sonst wird die Mitte der Höhen des RPC angenommen, und das Protokoll sagt es. Bilder in Sensorgeometrie brauchen sie nicht.</translation>
    </message>
    <message>
        <source>Tile size (px)</source>
        <translation>Kachelgröße (px)</translation>
    </message>
    <message>
        <source>0 means the largest tile whose error stays within the budget and which fits into memory.</source>
        <translation>0 bedeutet die größte Kachel, deren Fehler im Budget bleibt und die in den Speicher passt.</translation>
    </message>
    <message>
        <source>Error budget (px)</source>
        <translation>Fehlerbudget (px)</translation>
    </message>
    <message>
        <source>The equivalent error in the image that the pinhole model may have at most.</source>
        <translation>Der äquivalente Fehler im Bild, den das Lochkameramodell höchstens haben darf.</translation>
    </message>
    <message>
        <source>Refinement model</source>
        <translation>Modell der Verfeinerung</translation>
    </message>
    <message>
        <source>none: pinhole cameras on the images as they are; homography: plane to plane; polynomial: removes the curvature of the image; terrain: removes the parallax of altitude too, on a coarse surface.</source>
        <translation>none: Lochkameras auf den Bildern, wie sie sind; homography: Ebene auf Ebene; polynomial: behebt die Krümmung des Bildes; terrain: behebt auch die Höhenparallaxe, auf einer groben Oberfläche.</translation>
    </message>
    <message>
        <source>Order of the polynomial</source>
        <translation>Grad des Polynoms</translation>
    </message>
    <message>
        <source>2 is the paper's; 3 to 5 help only where the satellite's attitude changes quickly within a tile. Other models do not use it.</source>
        <translation>2 ist der der Veröffentlichung; 3 bis 5 helfen nur, wo sich die Lage des Satelliten innerhalb einer Kachel schnell ändert. Andere Modelle verwenden ihn nicht.</translation>
    </message>
    <message>
        <source>Resampling of the refined images</source>
        <translation>Neuabtastung der verfeinerten Bilder</translation>
    </message>
    <message>
        <source>bilinear: the paper's, and the fastest; cubic: sharper; lanczos: sharpest, may ring at edges. The heights are matched on the original images and do not depend on it.</source>
        <translation>bilinear: die des Artikels und die schnellste; cubic: schärfer; lanczos: am schärfsten, kann an Kanten überschwingen. Die Höhen werden auf den Originalbildern zugeordnet und hängen nicht davon ab.</translation>
    </message>
    <message>
        <source>Dense matching</source>
        <translation>Dichte Zuordnung</translation>
    </message>
    <message>
        <source>sgm: semi-global matching on the CPU; colmap: COLMAP's PatchMatch on a CUDA GPU; auto: sgm, which is faster and more accurate even beside an H100.</source>
        <translation>sgm: Semi-Global Matching auf der CPU; colmap: PatchMatch von COLMAP auf einer CUDA-GPU; auto: sgm, das selbst neben einer H100 schneller und genauer ist.</translation>
    </message>
    <message>
        <source>COLMAP: geometric consistency</source>
        <translation>COLMAP: geometrische Konsistenz</translation>
    </message>
    <message>
        <source>On: depths must also agree with those of the other images, in a second pass of the same length. Off: half the time, more outliers.</source>
        <translation>Ein: Tiefen müssen auch zu denen der anderen Bilder passen, in einem zweiten, gleich langen Durchgang. Aus: halbe Zeit, mehr Ausreißer.</translation>
    </message>
    <message>
        <source>COLMAP: only heights that its fusion keeps</source>
        <translation>COLMAP: nur Höhen, die seine Fusion behält</translation>
    </message>
    <message>
        <source>On: COLMAP's own fusion of the depth maps decides which heights the DSM uses: two images must agree in position, depth and slope. This gives fewer heights and fewer outliers.</source>
        <translation>Ein: COLMAPs eigene Fusion der Tiefenkarten entscheidet, welche Höhen das DOM verwendet: Zwei Bilder müssen in Ort, Tiefe und Neigung übereinstimmen. Das ergibt weniger Höhen und weniger Ausreißer.</translation>
    </message>
    <message>
        <source>COLMAP: radius of the window (px)</source>
        <translation>COLMAP: Radius des Fensters (px)</translation>
    </message>
    <message>
        <source>Smaller: sharper edges, more noise; larger: smoother, fills weak texture. The time grows with its square.</source>
        <translation>Kleiner: schärfere Kanten, mehr Rauschen; größer: glatter, füllt schwache Textur. Die Zeit wächst mit dem Quadrat.</translation>
    </message>
    <message>
        <source>COLMAP: memory of a GPU (GiB)</source>
        <translation>COLMAP: Speicher einer GPU (GiB)</translation>
    </message>
    <message>
        <source>A tile that needs more is matched in parts. 0: what is free.</source>
        <translation>Eine Kachel, die mehr braucht, wird in Teilen zugeordnet. 0: was frei ist.</translation>
    </message>
    <message>
        <source>DSM resolution (m)</source>
        <translation>Auflösung des DOM (m)</translation>
    </message>
    <message>
        <source>Cell size in units of the CRS. 0: twice the ground sampling distance of the images.</source>
        <translation>Zellgröße in Einheiten des KBS. 0: die doppelte Bodenauflösung der Bilder.</translation>
    </message>
    <message>
        <source>DSM resolution (m), 0: automatic</source>
        <translation>Auflösung des DOM (m), 0: automatisch</translation>
    </message>
    <message>
        <source>CRS of the results</source>
        <translation>KBS der Ergebnisse</translation>
    </message>
    <message>
        <source>A projected CRS. Empty: the scene's UTM zone.</source>
        <translation>Ein projiziertes KBS. Leer: die UTM-Zone der Szene.</translation>
    </message>
    <message>
        <source>Fusion of the pairs' heights</source>
        <translation>Fusion der Höhen der Paare</translation>
    </message>
    <message>
        <source>How the heights that agree are combined: mean has less noise, median is the paper's.</source>
        <translation>Wie die übereinstimmenden Höhen verbunden werden: mean rauscht weniger, median ist das Verfahren der Veröffentlichung.</translation>
    </message>
    <message>
        <source>Fill</source>
        <translation>Auffüllen</translation>
    </message>
    <message>
        <source>occlusions: cells that one image hides take the height of the ground behind, and cells that a shadow leaves without texture that of the ground where it ends; all: remaining holes are interpolated too; both are marked in the confidence raster. none: they stay nodata.</source>
        <translation>occlusions: Zellen, die ein Bild verdeckt, erhalten die Höhe des Bodens dahinter, und Zellen, die ein Schatten ohne Textur lässt, die des Bodens, auf dem er endet; all: übrige Lücken werden zudem interpoliert; beides ist im Konfidenzraster gekennzeichnet. none: sie bleiben ohne Wert.</translation>
    </message>
    <message>
        <source>Water surfaces</source>
        <translation>Wasserflächen</translation>
    </message>
    <message>
        <source>keep: as they were matched, mostly without heights; flatten: lakes get the level of their shore, and rivers fall along their flow. Water is found where multispectral images show it (NDWI), else where matching finds nothing and the images are dark and smooth; from 2000 m² and 12 m width on.</source>
        <translation>keep: wie sie zugeordnet wurden, meist ohne Höhen; flatten: Seen bekommen die Höhe ihres Ufers, und Flüsse fallen in Fließrichtung. Wasser wird gefunden, wo multispektrale Bilder es zeigen (NDWI), sonst wo die Zuordnung nichts findet und die Bilder dunkel und glatt sind; ab 2000 m² und 12 m Breite.</translation>
    </message>
    <message>
        <source>Outlier radius (m)</source>
        <translation>Ausreißerradius (m)</translation>
    </message>
    <message>
        <source>Points with too few neighbours within this distance are removed. 0: none.</source>
        <translation>Punkte mit zu wenigen Nachbarn innerhalb dieser Entfernung werden entfernt. 0: keine.</translation>
    </message>
    <message>
        <source>Most vertices of the mesh</source>
        <translation>Höchstens so viele Netzknoten</translation>
    </message>
    <message>
        <source>Where the DSM has more cells, the mesh has fewer vertices on level ground and roofs than at their edges. It has about two triangles for each vertex: 500000 make a million. 0: one for each cell.</source>
        <translation>Hat das DOM mehr Zellen, hat das Netz auf ebenem Boden und auf Dächern weniger Knoten als an deren Kanten. Es hat etwa zwei Dreiecke je Knoten: 500000 ergeben eine Million. 0: einer je Zelle.</translation>
    </message>
    <message>
        <source>Orthophoto resolution (m)</source>
        <translation>Auflösung des Orthophotos (m)</translation>
    </message>
    <message>
        <source>Cell size in units of the CRS, not coarser than the DSM's. 0: the ground sampling distance of the finest image. Half the size takes four times as long to make, and four times the space.</source>
        <translation>Zellgröße in Einheiten des KBS, nicht gröber als die des DOM. 0: die Bodenauflösung des feinsten Bildes. Die halbe Größe braucht viermal so lange und viermal so viel Platz.</translation>
    </message>
    <message>
        <source>Colours of orthophoto, point cloud and mesh</source>
        <translation>Farben von Orthophoto, Punktwolke und Netz</translation>
    </message>
    <message>
        <source>auto: natural colours where the images or the multispectral images have them, else greys; greys: one band; all: all bands, near infrared too.</source>
        <translation>auto: natürliche Farben, wo die Bilder oder die Multispektralbilder sie haben, sonst Grautöne; greys: ein Kanal; all: alle Kanäle, auch nahes Infrarot.</translation>
    </message>
    <message>
        <source>Multispectral images (XS) of the panchromatic ones</source>
        <translation>Multispektralbilder (XS) zu den panchromatischen</translation>
    </message>
    <message>
        <source>In any order, each with its own RPC: they are paired with the panchromatic images by their line of sight and time. Empty: those that lie beside the images under their vendors' names.</source>
        <translation>In beliebiger Reihenfolge, jedes mit eigenem RPC: Sie werden den panchromatischen Bildern nach Blickrichtung und Zeit zugeordnet. Leer: die, die unter den Namen der Anbieter neben den Bildern liegen.</translation>
    </message>
    <message>
        <source>Pansharpening of multispectral images</source>
        <translation>Pansharpening der Multispektralbilder</translation>
    </message>
    <message>
        <source>On: colours with the detail of the panchromatic images. Off: the multispectral pixels as they are.</source>
        <translation>An: Farben mit den Einzelheiten der panchromatischen Bilder. Aus: die Multispektralpixel, wie sie sind.</translation>
    </message>
    <message>
        <source>Normals in the point cloud</source>
        <translation>Normalen in der Punktwolke</translation>
    </message>
    <message>
        <source>For shading and meshing in CloudCompare and others. Fusing takes more than twice as long, and a LAZ is 1.6 times as large.</source>
        <translation>Zum Schattieren und Vernetzen in CloudCompare und anderen Programmen. Die Fusion dauert mehr als doppelt so lange, und eine LAZ-Datei wird 1,6-mal so groß.</translation>
    </message>
    <message>
        <source>Scene</source>
        <translation>Szene</translation>
    </message>
    <message>
        <source>The scene.json that the previous stage wrote.</source>
        <translation>Die scene.json, die die vorige Stufe geschrieben hat.</translation>
    </message>
    <message>
        <source>Footprints</source>
        <translation>Bildflächen</translation>
    </message>
    <message>
        <source>The outline of each image on the ground, with its time, its direction of view and the sun's.</source>
        <translation>Der Umriss jedes Bildes am Boden, mit seiner Zeit, seiner Blickrichtung und der Richtung zur Sonne.</translation>
    </message>
    <message>
        <source>Overlaps of pairs</source>
        <translation>Überlappungen der Paare</translation>
    </message>
    <message>
        <source>The ground that each two images share, and whether it is worth matching the two.</source>
        <translation>Der Boden, den je zwei Bilder gemeinsam zeigen, und ob sich ihre Zuordnung lohnt.</translation>
    </message>
    <message>
        <source>Workspace</source>
        <translation>Arbeitsordner</translation>
    </message>
    <message>
        <source>A folder for the scene and everything in between; a second run there continues where the first stopped.</source>
        <translation>Ein Ordner für die Szene und alle Zwischenergebnisse; ein zweiter Lauf macht dort weiter, wo der erste aufhörte.</translation>
    </message>
    <message>
        <source>Tiles</source>
        <translation>Kacheln</translation>
    </message>
    <message>
        <source>The outlines of the tiles, with the equivalent error of each image's camera in px.</source>
        <translation>Die Umrisse der Kacheln, mit dem äquivalenten Fehler der Kamera jedes Bildes in px.</translation>
    </message>
    <message>
        <source>Scene after this stage</source>
        <translation>Szene nach dieser Stufe</translation>
    </message>
    <message>
        <source>The results of this stage are kept in this file's folder. Skipped: beside the scene before it.</source>
        <translation>Die Ergebnisse dieser Stufe liegen im Ordner dieser Datei. Übersprungen: neben der Szene davor.</translation>
    </message>
    <message>
        <source>Tie points</source>
        <translation>Verknüpfungspunkte</translation>
    </message>
    <message>
        <source>Points on the ground that two or more images show, with their residuals in px.</source>
        <translation>Punkte am Boden, die zwei oder mehr Bilder zeigen, mit ihren Residuen in px.</translation>
    </message>
    <message>
        <source>Height maps</source>
        <translation>Höhenkarten</translation>
    </message>
    <message>
        <source>A folder for one height map of each pair and tile, from which the DSM is made. Skipped: beside the scene.</source>
        <translation>Ein Ordner für eine Höhenkarte je Paar und Kachel, aus denen das DOM entsteht. Weggelassen: neben der Szene.</translation>
    </message>
    <message>
        <source>Differences from the reference</source>
        <translation>Differenzen zur Referenz</translation>
    </message>
    <message>
        <source>The reference minus the scene's surface in metres: band 1 before, band 2 after the registration.</source>
        <translation>Die Referenz minus die Oberfläche der Szene in Metern: Kanal 1 vor, Kanal 2 nach der Einpassung.</translation>
    </message>
    <message>
        <source>Offsets of the scene's parts</source>
        <translation>Versätze der Teile der Szene</translation>
    </message>
    <message>
        <source>Arrows: the shift that each part of the scene would need, in metres.</source>
        <translation>Pfeile: die Verschiebung, die jeder Teil der Szene bräuchte, in Metern.</translation>
    </message>
    <message>
        <source>DSM</source>
        <translation>DOM</translation>
    </message>
    <message>
        <source>Heights in metres as a GeoTIFF; where nothing was matched, there is no height.</source>
        <translation>Höhen in Metern als GeoTIFF; wo nichts zugeordnet wurde, ist keine Höhe.</translation>
    </message>
    <message>
        <source>Confidence</source>
        <translation>Konfidenz</translation>
    </message>
    <message>
        <source>For each height: its expected error and LE90 in metres, how many pairs agree, and how it was found.</source>
        <translation>Zu jeder Höhe: ihr erwarteter Fehler und LE90 in Metern, wie viele Paare übereinstimmen und wie sie gefunden wurde.</translation>
    </message>
    <message>
        <source>Orthophoto</source>
        <translation>Orthophoto</translation>
    </message>
    <message>
        <source>The images in map geometry at their own resolution, in colour where the images have colours.</source>
        <translation>Die Bilder in Kartengeometrie mit ihrer eigenen Auflösung, farbig, wo die Bilder Farben haben.</translation>
    </message>
    <message>
        <source>Water</source>
        <translation>Wasser</translation>
    </message>
    <message>
        <source>1 where the images and the matching show water, 0 on land, 255 where neither is known.</source>
        <translation>1, wo die Bilder und die Zuordnung Wasser zeigen, 0 auf Land, 255, wo beides unbekannt ist.</translation>
    </message>
    <message>
        <source>Point cloud</source>
        <translation>Punktwolke</translation>
    </message>
    <message>
        <source>One point for each matched pixel, with its colour: LAZ, LAS, or PLY for 3-D programs without these.</source>
        <translation>Ein Punkt für jedes zugeordnete Pixel, mit seiner Farbe: LAZ, LAS oder PLY für 3D-Programme, die beides nicht lesen.</translation>
    </message>
    <message>
        <source>Point cloud for display (EPT)</source>
        <translation>Punktwolke zum Ansehen (EPT)</translation>
    </message>
    <message>
        <source>A folder of its own with the points as Entwine point tiles, which every QGIS shows.</source>
        <translation>Ein eigener Ordner mit den Punkten als Entwine-Punktkacheln, die jedes QGIS zeigt.</translation>
    </message>
    <message>
        <source>Mesh</source>
        <translation>Netz</translation>
    </message>
    <message>
        <source>Triangles: PLY for QGIS and 3-D programs, or GLB and OBJ with the orthophoto as picture, not for QGIS.</source>
        <translation>Dreiecke: PLY für QGIS und 3D-Programme, oder GLB und OBJ mit dem Orthophoto als Bild, nicht für QGIS.</translation>
    </message>
    <message>
        <source>DSM of each pair alone</source>
        <translation>DOM jedes Paares für sich</translation>
    </message>
    <message>
        <source>A folder for the surface that each pair of images gives on its own, with its confidence: to find out which pair an error comes from.</source>
        <translation>Ein Ordner für die Oberfläche, die jedes Bildpaar für sich ergibt, mit ihrer Konfidenz: um zu finden, von welchem Paar ein Fehler kommt.</translation>
    </message>
    <message>
        <source>Surface in the browser (3-D)</source>
        <translation>Oberfläche im Browser (3D)</translation>
    </message>
    <message>
        <source>The surface in 3-D, with rasters draped over it and profiles: a page for the browser, without any network.</source>
        <translation>Die Oberfläche in 3D, mit darübergelegten Rastern und Profilen: eine Seite für den Browser, ganz ohne Netz.</translation>
    </message>
    <message>
        <source>STAC item for catalogues</source>
        <translation>STAC-Eintrag für Kataloge</translation>
    </message>
    <message>
        <source>A STAC item beside the DSM: when and where the images were taken, and the files that were made.</source>
        <translation>Ein STAC-Eintrag neben dem DOM: wann und wo die Bilder aufgenommen wurden, und die Dateien, die entstanden.</translation>
    </message>
    <message>
        <source>Footprints of the scenes</source>
        <translation>Umrisse der Szenen</translation>
    </message>
    <message>
        <source>The outline of each scene, with its verdict, its figures, and links to its report and its DSM.</source>
        <translation>Der Umriss jeder Szene mit ihrem Urteil, ihren Zahlen und Links zu ihrem Bericht und ihrem DOM.</translation>
    </message>
    <message>
        <source>Workspace of all scenes</source>
        <translation>Arbeitsordner aller Szenen</translation>
    </message>
    <message>
        <source>A folder for one folder a scene, with its DSM and report; a second run there does what is left to do.</source>
        <translation>Ein Ordner für je einen Ordner pro Szene mit ihrem DOM und Bericht; ein zweiter Lauf dort macht, was noch fehlt.</translation>
    </message>
    <message>
        <source>Mosaic of the DSMs</source>
        <translation>Mosaik der DOM</translation>
    </message>
    <message>
        <source>DSM mosaic</source>
        <translation>DOM-Mosaik</translation>
    </message>
    <message>
        <source>A name that ends in .vrt gives a folder of tiles and a VRT that shows them as one: for very large mosaics.</source>
        <translation>Ein Name, der auf .vrt endet, ergibt einen Ordner mit Kacheln und ein VRT, das sie als ein Raster zeigt: für sehr große Mosaike.</translation>
    </message>
    <message>
        <source>Sources of the mosaic</source>
        <translation>Quellen des Mosaiks</translation>
    </message>
    <message>
        <source>The number of the DSM that each height comes from, how many DSMs have one there, and their spread.</source>
        <translation>Die Nummer des DOM, aus dem jede Höhe stammt, wie viele DOM dort eine haben, und ihre Streuung.</translation>
    </message>
    <message>
        <source>Terrain (DTM)</source>
        <translation>Gelände (DGM)</translation>
    </message>
    <message>
        <source>Heights of the bare ground in metres as a GeoTIFF, in the vertical datum of the DSM.</source>
        <translation>Höhen des nackten Bodens in Metern als GeoTIFF, mit dem Höhenbezug des DOM.</translation>
    </message>
    <message>
        <source>Heights above the terrain</source>
        <translation>Höhen über dem Gelände</translation>
    </message>
    <message>
        <source>The DSM minus the terrain in metres: how high houses and trees are.</source>
        <translation>Das DOM minus das Gelände in Metern: wie hoch Häuser und Bäume sind.</translation>
    </message>
    <message>
        <source>Objects</source>
        <translation>Objekte</translation>
    </message>
    <message>
        <source>1 where something stands on the ground, 0 where the DSM shows the ground, 255 where it has no height.</source>
        <translation>1, wo etwas auf dem Boden steht; 0, wo das DOM den Boden zeigt; 255, wo es keine Höhe hat.</translation>
    </message>
    <message>
        <source>Buildings</source>
        <translation>Gebäude</translation>
    </message>
    <message>
        <source>Outlines with straight walls; height above the ground with its error, kind of roof, area and volume.</source>
        <translation>Umrisse mit geraden Wänden; Höhe über dem Boden mit ihrem Fehler, Dachform, Fläche und Volumen.</translation>
    </message>
    <message>
        <source>Buildings in 3-D (CityJSON)</source>
        <translation>Gebäude in 3D (CityJSON)</translation>
    </message>
    <message>
        <source>Closed solids of the buildings for 3-D programs: blocks, and roofs where the DSM shows them.</source>
        <translation>Geschlossene Körper der Gebäude für 3D-Programme: Blöcke, und Dächer, wo das DOM sie zeigt.</translation>
    </message>
    <message>
        <source>Edited DSM</source>
        <translation>Bearbeitetes DOM</translation>
    </message>
    <message>
        <source>The DSM with all edits that are enabled, as a GeoTIFF; the original stays as it is.</source>
        <translation>Das DOM mit allen Bearbeitungen, die gelten, als GeoTIFF; das Original bleibt, wie es ist.</translation>
    </message>
    <message>
        <source>Confidence of the edited DSM</source>
        <translation>Konfidenz des bearbeiteten DOM</translation>
    </message>
    <message>
        <source>The confidence raster, in which edited heights have the source "edited" and no expected error.</source>
        <translation>Das Konfidenzraster, in dem bearbeitete Höhen die Quelle „von Hand bearbeitet“ und keinen erwarteten Fehler haben.</translation>
    </message>
    <message>
        <source>Equivalent error</source>
        <translation>Äquivalenter Fehler</translation>
    </message>
    <message>
        <source>How far the pinhole camera is from the RPC at each place on the ground, in px.</source>
        <translation>Wie weit die Lochkamera an jeder Stelle des Bodens vom RPC abweicht, in px.</translation>
    </message>
    <message>
        <source>Folder</source>
        <translation>Ordner</translation>
    </message>
    <message>
        <source>A folder that gets one model for each tile, with its images and cameras.</source>
        <translation>Ein Ordner, der für jede Kachel ein Modell mit ihren Bildern und Kameras erhält.</translation>
    </message>
    <message>
        <source>Folder for the corrected RPCs</source>
        <translation>Ordner für die korrigierten RPC</translation>
    </message>
    <message>
        <source>A folder of its own: for each image a VRT with its pixels and the corrected RPC, and the RPC as two text files.</source>
        <translation>Ein eigener Ordner: für jedes Bild ein VRT mit seinen Pixeln und dem korrigierten RPC, und das RPC als zwei Textdateien.</translation>
    </message>
    <message>
        <source>Height error</source>
        <translation>Höhenfehler</translation>
    </message>
    <message>
        <source>The DSM minus the reference in metres, cell by cell.</source>
        <translation>Das DOM minus die Referenz in Metern, Zelle für Zelle.</translation>
    </message>
    <message>
        <source>Points with their errors</source>
        <translation>Punkte mit ihren Fehlern</translation>
    </message>
    <message>
        <source>The control points, with how far each of them is from where the RPCs, the scene and the DSM put it.</source>
        <translation>Die Passpunkte, jeder mit dem Abstand von der Stelle, an die ihn RPC, Szene und DOM setzen.</translation>
    </message>
    <message>
        <source>Difference of the dates</source>
        <translation>Differenz der Zeitpunkte</translation>
    </message>
    <message>
        <source>AFTER minus BEFORE in metres, cell by cell, after the alignment.</source>
        <translation>AFTER minus BEFORE in Metern, Zelle für Zelle, nach der Ausrichtung.</translation>
    </message>
    <message>
        <source>Significant change</source>
        <translation>Signifikante Änderung</translation>
    </message>
    <message>
        <source>Band 1: what changed by more than the errors of both DSMs, m. Band 2: the level of detection, m.</source>
        <translation>Kanal 1: was sich um mehr als die Fehler beider DOM geändert hat, m. Kanal 2: die Nachweisgrenze, m.</translation>
    </message>
    <message>
        <source>Volumes of the changes</source>
        <translation>Volumen der Änderungen</translation>
    </message>
    <message>
        <source>Outlines of the significant changes, with area, heights, and volume with its uncertainty.</source>
        <translation>Umrisse der signifikanten Änderungen, mit Fläche, Höhen und Volumen samt Unsicherheit.</translation>
    </message>
    <message>
        <source>Heights of all dates</source>
        <translation>Höhen aller Zeitpunkte</translation>
    </message>
    <message>
        <source>A GeoTIFF with the heights of each date in a band of its own, all on the same cells, in metres.</source>
        <translation>Ein GeoTIFF mit den Höhen jedes Zeitpunkts in einem eigenen Kanal, alle auf denselben Zellen, in Metern.</translation>
    </message>
    <message>
        <source>Trend</source>
        <translation>Trend</translation>
    </message>
    <message>
        <source>Metres per year: the median trend of each cell, its standard error and its 95 % interval.</source>
        <translation>Meter pro Jahr: der Median-Trend jeder Zelle, sein Standardfehler und sein 95-%-Intervall.</translation>
    </message>
    <message>
        <source>Dates of change</source>
        <translation>Zeitpunkte der Änderung</translation>
    </message>
    <message>
        <source>For each cell the number of the date at which a change is seen first, and of the one at which it had ended.</source>
        <translation>Für jede Zelle die Nummer des Zeitpunkts, an dem eine Änderung zuerst zu sehen ist, und die des Zeitpunkts, an dem sie beendet war.</translation>
    </message>
    <message>
        <source>Volumes over time</source>
        <translation>Volumen im Lauf der Zeit</translation>
    </message>
    <message>
        <source>The areas, with their volume at each date since the first, and its uncertainty.</source>
        <translation>Die Flächen, mit ihrem Volumen zu jedem Zeitpunkt seit dem ersten und dessen Unsicherheit.</translation>
    </message>
    <message>
        <source>Layers of the dates</source>
        <translation>Layer der Zeitpunkte</translation>
    </message>
    <message>
        <source>A folder with a map layer for each date, which QGIS's temporal controller shows one after the other.</source>
        <translation>Ein Ordner mit einem Kartenlayer je Zeitpunkt, die die Zeitsteuerung von QGIS nacheinander zeigt.</translation>
    </message>
    <message>
        <source>Table of the volumes</source>
        <translation>Tabelle der Volumen</translation>
    </message>
    <message>
        <source>The volume of each area at each date as CSV, for spreadsheets.</source>
        <translation>Das Volumen jeder Fläche zu jedem Zeitpunkt als CSV, für Tabellenprogramme.</translation>
    </message>
    <message>
        <source>3-D Tiles</source>
        <translation>3-D Tiles</translation>
    </message>
    <message>
        <source>A folder of its own with tileset.json and GLB files, for CesiumJS, QGIS 3.34 and later, and other viewers.</source>
        <translation>Ein eigener Ordner mit tileset.json und GLB-Dateien, für CesiumJS, QGIS ab 3.34 und andere Programme.</translation>
    </message>
    <message>
        <source>A folder for the images, the true surface (a DSM) and the ground control points.</source>
        <translation>Ein Ordner für die Bilder, die wahre Oberfläche (ein DOM) und die Passpunkte.</translation>
    </message>
    <message>
        <source>True DSM</source>
        <translation>Wahres DOM</translation>
    </message>
    <message>
        <source>Report of the images</source>
        <translation>Bericht über die Bilder</translation>
    </message>
    <message>
        <source>A page for the browser with figures, pictures and warnings, in one file.</source>
        <translation>Eine Seite für den Browser mit Zahlen, Bildern und Warnungen, in einer Datei.</translation>
    </message>
    <message>
        <source>Report of the cameras</source>
        <translation>Bericht über die Kameras</translation>
    </message>
    <message>
        <source>Report of the refinement</source>
        <translation>Bericht über die Verfeinerung</translation>
    </message>
    <message>
        <source>Report of the registration</source>
        <translation>Bericht der Einpassung</translation>
    </message>
    <message>
        <source>Report of the DSM</source>
        <translation>Bericht über das DOM</translation>
    </message>
    <message>
        <source>Report of the run</source>
        <translation>Bericht über den Lauf</translation>
    </message>
    <message>
        <source>Report of all scenes</source>
        <translation>Bericht über alle Szenen</translation>
    </message>
    <message>
        <source>Report of the mosaic</source>
        <translation>Bericht über das Mosaik</translation>
    </message>
    <message>
        <source>Report of the terrain</source>
        <translation>Bericht über das Gelände</translation>
    </message>
    <message>
        <source>Report of the buildings</source>
        <translation>Bericht über die Gebäude</translation>
    </message>
    <message>
        <source>Report of the equivalent error</source>
        <translation>Bericht über den äquivalenten Fehler</translation>
    </message>
    <message>
        <source>Report of the comparison</source>
        <translation>Bericht über den Vergleich</translation>
    </message>
    <message>
        <source>Report of the change</source>
        <translation>Bericht über die Änderung</translation>
    </message>
    <message>
        <source>Report of the series</source>
        <translation>Bericht über die Zeitreihe</translation>
    </message>
    <message>
        <source>Report of the control points</source>
        <translation>Bericht über die Passpunkte</translation>
    </message>
    <message>
        <source>Report of the corrected RPCs</source>
        <translation>Bericht zu den korrigierten RPC</translation>
    </message>
    <message>
        <source>Report of the environment</source>
        <translation>Bericht über die Umgebung</translation>
    </message>
    <message>
        <source>Number of images that can be used</source>
        <translation>Anzahl der verwendbaren Bilder</translation>
    </message>
    <message>
        <source>Number of pairs that are worth matching</source>
        <translation>Anzahl der Paare, deren Zuordnung sich lohnt</translation>
    </message>
    <message>
        <source>Images of the best pair</source>
        <translation>Bilder des besten Paars</translation>
    </message>
    <message>
        <source>Images of the best triplet</source>
        <translation>Bilder des besten Tripels</translation>
    </message>
    <message>
        <source>Equivalent error, RMSE (px)</source>
        <translation>Äquivalenter Fehler, RMSE (px)</translation>
    </message>
    <message>
        <source>Equivalent error, largest (px)</source>
        <translation>Äquivalenter Fehler, größter (px)</translation>
    </message>
    <message>
        <source>Remaining equivalent error, RMSE (px)</source>
        <translation>Verbleibender äquivalenter Fehler, RMSE (px)</translation>
    </message>
    <message>
        <source>Remaining equivalent error, largest (px)</source>
        <translation>Verbleibender äquivalenter Fehler, größter (px)</translation>
    </message>
    <message>
        <source>Number of images</source>
        <translation>Anzahl der Bilder</translation>
    </message>
    <message>
        <source>Images with corrected RPCs</source>
        <translation>Bilder mit korrigierten RPC</translation>
    </message>
    <message>
        <source>Largest difference from the pointed model (px)</source>
        <translation>Größte Abweichung vom ausgerichteten Modell (px)</translation>
    </message>
    <message>
        <source>Report of the matching</source>
        <translation>Bericht über die Bildzuordnung</translation>
    </message>
    <message>
        <source>Number of tie points</source>
        <translation>Anzahl der Verknüpfungspunkte</translation>
    </message>
    <message>
        <source>Added to the east (m)</source>
        <translation>Verschiebung nach Osten (m)</translation>
    </message>
    <message>
        <source>Added to the north (m)</source>
        <translation>Verschiebung nach Norden (m)</translation>
    </message>
    <message>
        <source>Added up (m)</source>
        <translation>Verschiebung nach oben (m)</translation>
    </message>
    <message>
        <source>Standard deviation to the east (m)</source>
        <translation>Standardabweichung nach Osten (m)</translation>
    </message>
    <message>
        <source>Standard deviation to the north (m)</source>
        <translation>Standardabweichung nach Norden (m)</translation>
    </message>
    <message>
        <source>Standard deviation up (m)</source>
        <translation>Standardabweichung nach oben (m)</translation>
    </message>
    <message>
        <source>Cells with a height (%)</source>
        <translation>Zellen mit Höhe (%)</translation>
    </message>
    <message>
        <source>Images of the preview's pairs</source>
        <translation>Bilder der Paare der Vorschau</translation>
    </message>
    <message>
        <source>Lowest altitude for the DSM (m)</source>
        <translation>Niedrigste Höhe für das DOM (m)</translation>
    </message>
    <message>
        <source>Highest altitude for the DSM (m)</source>
        <translation>Höchste Höhe für das DOM (m)</translation>
    </message>
    <message>
        <source>DSMs</source>
        <translation>DOM</translation>
    </message>
    <message>
        <source>Number of scenes</source>
        <translation>Anzahl der Szenen</translation>
    </message>
    <message>
        <source>Scenes that failed</source>
        <translation>Szenen, die gescheitert sind</translation>
    </message>
    <message>
        <source>Scenes that were complete before</source>
        <translation>Szenen, die schon vorher fertig waren</translation>
    </message>
    <message>
        <source>Difference of two DSMs along the seams, median (m)</source>
        <translation>Unterschied zweier DOM entlang der Nähte, Median (m)</translation>
    </message>
    <message>
        <source>Heights that belong to objects (%)</source>
        <translation>Höhen, die zu Objekten gehören (%)</translation>
    </message>
    <message>
        <source>Cells with a terrain (%)</source>
        <translation>Zellen mit Gelände (%)</translation>
    </message>
    <message>
        <source>Number of buildings</source>
        <translation>Anzahl der Gebäude</translation>
    </message>
    <message>
        <source>Buildings with the planes of their roofs</source>
        <translation>Gebäude mit den Ebenen ihrer Dächer</translation>
    </message>
    <message>
        <source>Area of all footprints (m²)</source>
        <translation>Fläche aller Grundrisse (m²)</translation>
    </message>
    <message>
        <source>Volume of all buildings (m³)</source>
        <translation>Volumen aller Gebäude (m³)</translation>
    </message>
    <message>
        <source>Number of edits</source>
        <translation>Zahl der Bearbeitungen</translation>
    </message>
    <message>
        <source>Cells that edits cover</source>
        <translation>Zellen, die Bearbeitungen bedecken</translation>
    </message>
    <message>
        <source>RMSE (m)</source>
        <translation>RMSE (m)</translation>
    </message>
    <message>
        <source>Median absolute error (m)</source>
        <translation>Median des absoluten Fehlers (m)</translation>
    </message>
    <message>
        <source>Mean absolute error (m)</source>
        <translation>Mittlerer absoluter Fehler (m)</translation>
    </message>
    <message>
        <source>Normalised median absolute deviation (m)</source>
        <translation>Normalisierte mediane absolute Abweichung (m)</translation>
    </message>
    <message>
        <source>LE90 (m): nine of ten heights are off by no more</source>
        <translation>LE90 (m): neun von zehn Höhen sind höchstens so falsch</translation>
    </message>
    <message>
        <source>Completeness at the first threshold (%)</source>
        <translation>Vollständigkeit an der ersten Schwelle (%)</translation>
    </message>
    <message>
        <source>Number of significant changes</source>
        <translation>Anzahl signifikanter Änderungen</translation>
    </message>
    <message>
        <source>Volume gained (m³)</source>
        <translation>Gewonnenes Volumen (m³)</translation>
    </message>
    <message>
        <source>Its standard deviation (m³)</source>
        <translation>Dessen Standardabweichung (m³)</translation>
    </message>
    <message>
        <source>Volume lost (m³)</source>
        <translation>Verlorenes Volumen (m³)</translation>
    </message>
    <message>
        <source>Level of detection, median (m)</source>
        <translation>Nachweisgrenze, Median (m)</translation>
    </message>
    <message>
        <source>Number of dates</source>
        <translation>Zahl der Zeitpunkte</translation>
    </message>
    <message>
        <source>Ground that rises significantly (m²)</source>
        <translation>Boden, der signifikant steigt (m²)</translation>
    </message>
    <message>
        <source>Ground that falls significantly (m²)</source>
        <translation>Boden, der signifikant sinkt (m²)</translation>
    </message>
    <message>
        <source>Volume of the first area at the last date (m³)</source>
        <translation>Volumen der ersten Fläche am letzten Zeitpunkt (m³)</translation>
    </message>
    <message>
        <source>MedAE of heights by RPC localisation (m)</source>
        <translation>MedAE der Höhen durch RPC-Lokalisierung (m)</translation>
    </message>
    <message>
        <source>RMSE of heights by RPC localisation (m)</source>
        <translation>RMSE der Höhen durch RPC-Lokalisierung (m)</translation>
    </message>
    <message>
        <source>LE90 of heights by RPC localisation (m)</source>
        <translation>LE90 der Höhen durch RPC-Lokalisierung (m)</translation>
    </message>
    <message>
        <source>Max of heights by RPC localisation (m)</source>
        <translation>Max der Höhen durch RPC-Lokalisierung (m)</translation>
    </message>
    <message>
        <source>MedAE of heights by RPCs with image-space compensation (m)</source>
        <translation>MedAE der Höhen durch RPC mit Korrektur im Bildraum (m)</translation>
    </message>
    <message>
        <source>RMSE of heights by RPCs with image-space compensation (m)</source>
        <translation>RMSE der Höhen durch RPC mit Korrektur im Bildraum (m)</translation>
    </message>
    <message>
        <source>LE90 of heights by RPCs with image-space compensation (m)</source>
        <translation>LE90 der Höhen durch RPC mit Korrektur im Bildraum (m)</translation>
    </message>
    <message>
        <source>Max of heights by RPCs with image-space compensation (m)</source>
        <translation>Max der Höhen durch RPC mit Korrektur im Bildraum (m)</translation>
    </message>
    <message>
        <source>MedAE of heights by the scene's pointing (m)</source>
        <translation>MedAE der Höhen durch die Ausrichtung der Szene (m)</translation>
    </message>
    <message>
        <source>RMSE of heights by the scene's pointing (m)</source>
        <translation>RMSE der Höhen durch die Ausrichtung der Szene (m)</translation>
    </message>
    <message>
        <source>LE90 of heights by the scene's pointing (m)</source>
        <translation>LE90 der Höhen durch die Ausrichtung der Szene (m)</translation>
    </message>
    <message>
        <source>Max of heights by the scene's pointing (m)</source>
        <translation>Max der Höhen durch die Ausrichtung der Szene (m)</translation>
    </message>
    <message>
        <source>MedAE of heights by the DSM (m)</source>
        <translation>MedAE der Höhen durch das DOM (m)</translation>
    </message>
    <message>
        <source>RMSE of heights by the DSM (m)</source>
        <translation>RMSE der Höhen durch das DOM (m)</translation>
    </message>
    <message>
        <source>LE90 of heights by the DSM (m)</source>
        <translation>LE90 der Höhen durch das DOM (m)</translation>
    </message>
    <message>
        <source>Max of heights by the DSM (m)</source>
        <translation>Max der Höhen durch das DOM (m)</translation>
    </message>
    <message>
        <source>CE90 of positions by RPC localisation (m)</source>
        <translation>CE90 der Lage durch RPC-Lokalisierung (m)</translation>
    </message>
    <message>
        <source>CE90 of positions by RPCs with image-space compensation (m)</source>
        <translation>CE90 der Lage durch RPC mit Korrektur im Bildraum (m)</translation>
    </message>
    <message>
        <source>CE90 of positions by the scene's pointing (m)</source>
        <translation>CE90 der Lage durch die Ausrichtung der Szene (m)</translation>
    </message>
    <message>
        <source>The file to open: tileset.json</source>
        <translation>Die Datei zum Öffnen: tileset.json</translation>
    </message>
</context>
<context>
    <name>RepmPreview</name>
    <message>
        <source>Preview</source>
        <translation>Vorschau</translation>
    </message>
    <message>
        <source>Show all the ground of these images at 8 times their ground sampling distance, in seconds</source>
        <translation>In Sekunden das ganze Gelände dieser Bilder zeigen, mit achtmal so großen Pixeln</translation>
    </message>
</context>
<context>
    <name>RepmProvider</name>
    <message>
        <source>REPM: surface models from satellite images ({version})</source>
        <translation>REPM: Oberflächenmodelle aus Satellitenbildern ({version})</translation>
    </message>
</context>
<context>
    <name>RepmSettings</name>
    <message>
        <source>Engine interpreter (empty: the engine's own environment, else QGIS's Python)</source>
        <translation>Interpreter der Engine (leer: eigene Umgebung der Engine, sonst Python von QGIS)</translation>
    </message>
    <message>
        <source>Worker processes (0: one per core)</source>
        <translation>Arbeitsprozesse (0: einer je Kern)</translation>
    </message>
    <message>
        <source>Memory of all workers together (MiB, 0: three quarters of what is free)</source>
        <translation>Speicher aller Arbeitsprozesse zusammen (MiB, 0: drei Viertel des freien)</translation>
    </message>
    <message>
        <source>Dask cluster: address of the scheduler, or its scheduler file (empty: this machine)</source>
        <translation>Dask-Cluster: Adresse des Schedulers oder seine Scheduler-Datei (leer: dieser Rechner)</translation>
    </message>
    <message>
        <source>COLMAP: geometric consistency</source>
        <translation>COLMAP: geometrische Konsistenz</translation>
    </message>
    <message>
        <source>COLMAP: only heights that its fusion keeps</source>
        <translation>COLMAP: nur Höhen, die seine Fusion behält</translation>
    </message>
    <message>
        <source>COLMAP: radius of the window (px)</source>
        <translation>COLMAP: Radius des Fensters (px)</translation>
    </message>
    <message>
        <source>COLMAP: memory of a GPU (GiB, 0: what is free)</source>
        <translation>COLMAP: Speicher einer GPU (GiB, 0: was frei ist)</translation>
    </message>
</context>
<context>
    <name>RepmWords</name>
    <message>
        <source>Automatic</source>
        <translation>Automatisch</translation>
    </message>
    <message>
        <source>None</source>
        <translation>Keine</translation>
    </message>
    <message>
        <source>All</source>
        <translation>Alle</translation>
    </message>
    <message>
        <source>Preview</source>
        <translation>Vorschau</translation>
    </message>
    <message>
        <source>Default</source>
        <translation>Standard</translation>
    </message>
    <message>
        <source>Best</source>
        <translation>Beste</translation>
    </message>
    <message>
        <source>Fewest</source>
        <translation>Wenigste</translation>
    </message>
    <message>
        <source>City</source>
        <translation>Stadt</translation>
    </message>
    <message>
        <source>Mountains</source>
        <translation>Gebirge</translation>
    </message>
    <message>
        <source>Town</source>
        <translation>Ortschaft</translation>
    </message>
    <message>
        <source>Shift</source>
        <translation>Verschiebung</translation>
    </message>
    <message>
        <source>Affine</source>
        <translation>Affin</translation>
    </message>
    <message>
        <source>Affine and jitter</source>
        <translation>Affin und Zittern</translation>
    </message>
    <message>
        <source>Shift and tilt</source>
        <translation>Verschiebung und Neigung</translation>
    </message>
    <message>
        <source>Vertical offset</source>
        <translation>Höhenversatz</translation>
    </message>
    <message>
        <source>3-D shift</source>
        <translation>3-D-Verschiebung</translation>
    </message>
    <message>
        <source>3-D shift by nearest points</source>
        <translation>3-D-Verschiebung über nächste Punkte</translation>
    </message>
    <message>
        <source>Mean</source>
        <translation>Mittel</translation>
    </message>
    <message>
        <source>Median</source>
        <translation>Median</translation>
    </message>
    <message>
        <source>Occlusions</source>
        <translation>Verdeckungen</translation>
    </message>
    <message>
        <source>Inside</source>
        <translation>Innen</translation>
    </message>
    <message>
        <source>Greys</source>
        <translation>Grautöne</translation>
    </message>
    <message>
        <source>Homography</source>
        <translation>Homographie</translation>
    </message>
    <message>
        <source>Polynomial</source>
        <translation>Polynom</translation>
    </message>
    <message>
        <source>Terrain</source>
        <translation>Gelände</translation>
    </message>
    <message>
        <source>Bilinear</source>
        <translation>Bilinear</translation>
    </message>
    <message>
        <source>Cubic</source>
        <translation>Kubisch</translation>
    </message>
    <message>
        <source>Lanczos</source>
        <translation>Lanczos</translation>
    </message>
    <message>
        <source>Semi-global matching</source>
        <translation>Semi-Global Matching</translation>
    </message>
    <message>
        <source>COLMAP on a GPU</source>
        <translation>COLMAP auf einer GPU</translation>
    </message>
    <message>
        <source>With the RPCs</source>
        <translation>Mit den RPC</translation>
    </message>
    <message>
        <source>With COLMAP</source>
        <translation>Mit COLMAP</translation>
    </message>
    <message>
        <source>First look</source>
        <translation>Erster Blick</translation>
    </message>
    <message>
        <source>Fewest pairs</source>
        <translation>Wenigste Paare</translation>
    </message>
    <message>
        <source>All holes</source>
        <translation>Alle Löcher</translation>
    </message>
    <message>
        <source>All bands</source>
        <translation>Alle Kanäle</translation>
    </message>
    <message>
        <source>As matched</source>
        <translation>Wie zugeordnet</translation>
    </message>
    <message>
        <source>Flat, rivers fall</source>
        <translation>Eben, Flüsse fallen</translation>
    </message>
    <message>
        <source>Images</source>
        <translation>Bilder</translation>
    </message>
    <message>
        <source>Area and heights</source>
        <translation>Gebiet und Höhen</translation>
    </message>
    <message>
        <source>Control and references</source>
        <translation>Passpunkte und Referenzen</translation>
    </message>
    <message>
        <source>Cameras</source>
        <translation>Kameras</translation>
    </message>
    <message>
        <source>Matching</source>
        <translation>Zuordnung</translation>
    </message>
    <message>
        <source>Surface</source>
        <translation>Oberfläche</translation>
    </message>
    <message>
        <source>Orthophoto, colours, point cloud and mesh</source>
        <translation>Orthophoto, Farben, Punktwolke und Netz</translation>
    </message>
    <message>
        <source>WGS 84 ellipsoid</source>
        <translation>Ellipsoid WGS 84</translation>
    </message>
    <message>
        <source>automatic</source>
        <translation>automatisch</translation>
    </message>
    <message>
        <source>the first</source>
        <translation>die erste</translation>
    </message>
    <message>
        <source>all</source>
        <translation>alle</translation>
    </message>
    <message>
        <source>the middle</source>
        <translation>die Mitte</translation>
    </message>
    <message>
        <source>off</source>
        <translation>aus</translation>
    </message>
    <message>
        <source>one for each cell</source>
        <translation>einer je Zelle</translation>
    </message>
    <message>
        <source>what is free</source>
        <translation>was frei ist</translation>
    </message>
    <message>
        <source>Automatic: what each file says, or else what fits</source>
        <translation>Automatisch: was jede Datei sagt, sonst was passt</translation>
    </message>
</context>
<context>
    <name>SampleData</name>
    <message>
        <source>Make sample images</source>
        <translation>Beispielbilder erzeugen</translation>
    </message>
    <message>
        <source>Simulated tri-stereo images with RPCs of a known surface, to try the plugin and to measure its accuracy.</source>
        <translation>Simulierte Tri-Stereo-Bilder mit RPC von einer bekannten Oberfläche, um das Plugin auszuprobieren und seine Genauigkeit zu messen.</translation>
    </message>
    <message>
        <source>Landscape</source>
        <translation>Landschaft</translation>
    </message>
    <message>
        <source>urban: a town with houses, trees and cars; mountains: steep ground without houses.</source>
        <translation>urban: eine Stadt mit Häusern, Bäumen und Autos; mountains: steiles Gelände ohne Häuser.</translation>
    </message>
    <message>
        <source>Size of the images (px)</source>
        <translation>Größe der Bilder (px)</translation>
    </message>
    <message>
        <source>Columns and rows of each image: 800 takes a quarter of the time of 1600.</source>
        <translation>Spalten und Zeilen jedes Bildes: 800 braucht ein Viertel der Zeit von 1600.</translation>
    </message>
    <message>
        <source>Seed</source>
        <translation>Startwert</translation>
    </message>
    <message>
        <source>The same seed makes the same files.</source>
        <translation>Derselbe Startwert erzeugt dieselben Dateien.</translation>
    </message>
    <message>
        <source>Sample images</source>
        <translation>Beispielbilder</translation>
    </message>
    <message>
        <source>True DSM</source>
        <translation>Wahres DOM</translation>
    </message>
    <message>
        <source>Ground control points</source>
        <translation>Passpunkte</translation>
    </message>
</context>
<context>
    <name>SceneActions</name>
    <message>
        <source>QGIS cannot open '{path}'.</source>
        <translation>QGIS kann „{path}“ nicht öffnen.</translation>
    </message>
    <message>
        <source>The command is in the clipboard.</source>
        <translation>Der Befehl ist in der Zwischenablage.</translation>
    </message>
    <message>
        <source>The page could not be written to '{path}': check the folder.</source>
        <translation>Die Seite konnte nicht nach „{path}“ geschrieben werden: den Ordner prüfen.</translation>
    </message>
    <message>
        <source>Edit the page</source>
        <translation>Seite bearbeiten</translation>
    </message>
    <message>
        <source>Open the PDF</source>
        <translation>PDF öffnen</translation>
    </message>
    <message>
        <source>The page is '{name}'.</source>
        <translation>Die Seite heißt „{name}“.</translation>
    </message>
    <message>
        <source>These files are removed from the disk, and cannot be restored:</source>
        <translation>Diese Dateien werden vom Datenträger entfernt und sind nicht wiederherzustellen:</translation>
    </message>
    <message>
        <source>Remove products</source>
        <translation>Produkte entfernen</translation>
    </message>
    <message>
        <source>A folder with a scene</source>
        <translation>Ein Ordner mit einer Szene</translation>
    </message>
    <message>
        <source>Where is '{name}' now?</source>
        <translation>Wo ist „{name}“ jetzt?</translation>
    </message>
    <message>
        <source>'{folder}' holds no scene of REPM: choose the folder with scene.json.</source>
        <translation>„{folder}“ enthält keine Szene von REPM: Wählen Sie den Ordner mit scene.json.</translation>
    </message>
</context>
<context>
    <name>ScenesDock</name>
    <message>
        <source>REPM scenes</source>
        <translation>REPM-Szenen</translation>
    </message>
    <message>
        <source>Scene</source>
        <translation>Szene</translation>
    </message>
    <message>
        <source>About it</source>
        <translation>Angaben</translation>
    </message>
    <message>
        <source>What next</source>
        <translation>Wie weiter</translation>
    </message>
    <message>
        <source>Add a workspace…</source>
        <translation>Arbeitsordner hinzufügen…</translation>
    </message>
    <message>
        <source>Refresh</source>
        <translation>Neu lesen</translation>
    </message>
    <message>
        <source>In use by {owner}</source>
        <translation>In Verwendung durch {owner}</translation>
    </message>
    <message>
        <source>not there</source>
        <translation>nicht da</translation>
    </message>
    <message>
        <source>Images ({count})</source>
        <translation>Bilder ({count})</translation>
    </message>
    <message>
        <source>Runs ({count})</source>
        <translation>Läufe ({count})</translation>
    </message>
    <message>
        <source>Products ({count})</source>
        <translation>Produkte ({count})</translation>
    </message>
    <message>
        <source>time unknown</source>
        <translation>Zeit unbekannt</translation>
    </message>
    <message>
        <source>{time} UTC</source>
        <translation>{time} UTC</translation>
    </message>
    <message>
        <source>sun {elevation}°</source>
        <translation>Sonne {elevation}°</translation>
    </message>
    <message>
        <source>sun {elevation}° high in {azimuth}°</source>
        <translation>Sonne {elevation}° hoch in {azimuth}°</translation>
    </message>
    <message>
        <source>Record of the scene</source>
        <translation>Aufzeichnung der Szene</translation>
    </message>
    <message>
        <source>all defaults</source>
        <translation>alles Vorgaben</translation>
    </message>
    <message>
        <source>No scene yet: make a DSM, or add a workspace that you have.</source>
        <translation>Noch keine Szene: Erstellen Sie ein DOM, oder fügen Sie einen Arbeitsordner hinzu, den Sie haben.</translation>
    </message>
    <message>
        <source>Where is it now…</source>
        <translation>Wo ist er jetzt…</translation>
    </message>
    <message>
        <source>Forget this folder</source>
        <translation>Diesen Ordner vergessen</translation>
    </message>
    <message>
        <source>Open in the browser</source>
        <translation>Im Browser öffnen</translation>
    </message>
    <message>
        <source>Zoom to it</source>
        <translation>Dorthin zoomen</translation>
    </message>
    <message>
        <source>Zoom to the scene</source>
        <translation>Auf die Szene zoomen</translation>
    </message>
    <message>
        <source>Open the report</source>
        <translation>Bericht öffnen</translation>
    </message>
    <message>
        <source>Show the folder</source>
        <translation>Ordner zeigen</translation>
    </message>
    <message>
        <source>Run again…</source>
        <translation>Noch einmal ausführen…</translation>
    </message>
    <message>
        <source>Copy the command</source>
        <translation>Befehl kopieren</translation>
    </message>
    <message>
        <source>Remove ({size})…</source>
        <translation>Entfernen ({size})…</translation>
    </message>
    <message>
        <source>Remove all products ({size})…</source>
        <translation>Alle Produkte entfernen ({size})…</translation>
    </message>
    <message>
        <source>Compare with a reference…</source>
        <translation>Mit einer Referenz vergleichen…</translation>
    </message>
    <message>
        <source>Register to a reference…</source>
        <translation>Auf eine Referenz einpassen…</translation>
    </message>
    <message>
        <source>Terrain (DTM)…</source>
        <translation>Gelände (DGM)…</translation>
    </message>
    <message>
        <source>Buildings…</source>
        <translation>Gebäude…</translation>
    </message>
    <message>
        <source>Page for the browser (3-D)…</source>
        <translation>Seite für den Browser (3-D)…</translation>
    </message>
    <message>
        <source>Page for the client (PDF)</source>
        <translation>Seite für den Kunden (PDF)</translation>
    </message>
    <message>
        <source>Edit the DSM…</source>
        <translation>DOM bearbeiten…</translation>
    </message>
    <message>
        <source>Measure control points…</source>
        <translation>Passpunkte messen…</translation>
    </message>
</context>
<context>
    <name>Series</name>
    <message>
        <source>Follow a surface over many dates</source>
        <translation>Oberfläche über viele Zeitpunkte verfolgen</translation>
    </message>
    <message>
        <source>Trends with their errors, dates of change and volumes over time, from three DSMs or more.</source>
        <translation>Trends mit ihren Fehlern, Zeitpunkte der Änderung und Volumen im Lauf der Zeit, aus drei oder mehr DOM.</translation>
    </message>
    <message>
        <source>DSMs of all dates</source>
        <translation>DOM aller Zeitpunkte</translation>
    </message>
    <message>
        <source>Three or more rasters of heights in metres, in any order and any CRS, with heights of one datum. Register them before, or set the alignment.</source>
        <translation>Drei oder mehr Raster mit Höhen in Metern, in beliebiger Reihenfolge und beliebigem KBS, mit einem Höhenbezug. Vorher registrieren, oder die Ausrichtung setzen.</translation>
    </message>
    <message>
        <source>Dates of the DSMs</source>
        <translation>Zeitpunkte der DOM</translation>
    </message>
    <message>
        <source>One for each DSM, in the order of the DSMs, with commas between: 2022-05-01, 2023-04-17, ... Empty: the files say it, as DSMs of this plugin and STAC items beside them do.</source>
        <translation>Einer je DOM, in der Reihenfolge der DOM, durch Kommas getrennt: 2022-05-01, 2023-04-17, ... Leer: die Dateien geben sie an, wie es DOM dieses Plugins und STAC-Items daneben tun.</translation>
    </message>
    <message>
        <source>Areas whose volumes are followed</source>
        <translation>Flächen, deren Volumen verfolgt werden</translation>
    </message>
    <message>
        <source>Polygons such as glaciers or quarries, named by their field 'name'; the ground outside of them is taken as stable. Empty: what changed significantly is outlined.</source>
        <translation>Polygone wie Gletscher oder Steinbrüche, benannt durch ihr Feld „name“; der Boden außerhalb gilt als stabil. Leer: Was sich signifikant geändert hat, wird umrissen.</translation>
    </message>
    <message>
        <source>Alignment on stable ground</source>
        <translation>Ausrichtung auf stabilem Boden</translation>
    </message>
    <message>
        <source>none: offsets of the dates are reported and counted as errors; vertical: each DSM is moved up or down until it agrees with the first where nothing changed; 3d: in all three axes.</source>
        <translation>none: Versätze der Zeitpunkte werden gemeldet und als Fehler gezählt; vertical: jedes DOM wird nach oben oder unten verschoben, bis es mit dem ersten übereinstimmt, wo sich nichts geändert hat; 3d: in allen drei Achsen.</translation>
    </message>
    <message>
        <source>Smallest area (m²)</source>
        <translation>Kleinste Fläche (m²)</translation>
    </message>
    <message>
        <source>Smaller areas of change are not outlined; areas that you give have any size.</source>
        <translation>Kleinere Änderungen werden nicht umrissen; angegebene Flächen dürfen beliebig klein sein.</translation>
    </message>
    <message>
        <source>Heights that were filled in do not count then, and each height has its own error. Empty: one error for each date, found where nothing changed.</source>
        <translation>Dann zählen gefüllte Höhen nicht, und jede Höhe hat ihren eigenen Fehler. Leer: ein Fehler je Zeitpunkt, bestimmt, wo sich nichts geändert hat.</translation>
    </message>
    <message>
        <source>Heights</source>
        <translation>Höhen</translation>
    </message>
</context>
<context>
    <name>StagesModel</name>
    <message>
        <source>Make a DSM stage by stage (model)</source>
        <translation>DOM Stufe für Stufe erzeugen (Modell)</translation>
    </message>
</context>
<context>
    <name>SurfaceEditingDock</name>
    <message>
        <source>Edit a DSM</source>
        <translation>DOM bearbeiten</translation>
    </message>
    <message>
        <source>The DSM that is edited. It stays as it is: the edited one lies beside it.</source>
        <translation>Das DOM, das bearbeitet wird. Es bleibt, wie es ist: Das bearbeitete liegt daneben.</translation>
    </message>
    <message>
        <source>The confidence of this DSM, if there is one: a copy of it says which heights were edited by hand.</source>
        <translation>Die Konfidenz dieses DOM, falls es eine gibt: Eine Kopie von ihr sagt, welche Höhen von Hand bearbeitet wurden.</translation>
    </message>
    <message>
        <source>Remove heights</source>
        <translation>Höhen entfernen</translation>
    </message>
    <message>
        <source>Fill from the rim</source>
        <translation>Vom Rand aus füllen</translation>
    </message>
    <message>
        <source>Set to a height</source>
        <translation>Auf eine Höhe setzen</translation>
    </message>
    <message>
        <source>Flatten water</source>
        <translation>Wasser einebnen</translation>
    </message>
    <message>
        <source>Keep a breakline</source>
        <translation>Bruchkante halten</translation>
    </message>
    <message>
        <source>The width of the brush, or the width within which a breakline fades.</source>
        <translation>Die Breite des Pinsels oder die Breite, innerhalb derer eine Bruchkante ausläuft.</translation>
    </message>
    <message>
        <source>Polygon</source>
        <translation>Polygon</translation>
    </message>
    <message>
        <source>Brush</source>
        <translation>Pinsel</translation>
    </message>
    <message>
        <source>Line</source>
        <translation>Linie</translation>
    </message>
    <message>
        <source>Undo</source>
        <translation>Rückgängig</translation>
    </message>
    <message>
        <source>Removes the last edit of the list.</source>
        <translation>Entfernt die letzte Bearbeitung der Liste.</translation>
    </message>
    <message>
        <source>The edits in their order. One without its tick is passed over.</source>
        <translation>Die Bearbeitungen in ihrer Reihenfolge. Eine ohne Häkchen wird übergangen.</translation>
    </message>
    <message>
        <source>DSM:</source>
        <translation>DOM:</translation>
    </message>
    <message>
        <source>Confidence:</source>
        <translation>Konfidenz:</translation>
    </message>
    <message>
        <source>Edit:</source>
        <translation>Bearbeitung:</translation>
    </message>
    <message>
        <source>Height:</source>
        <translation>Höhe:</translation>
    </message>
    <message>
        <source>Width:</source>
        <translation>Breite:</translation>
    </message>
    <message>
        <source>Choose the DSM that is to be edited.</source>
        <translation>Das DOM wählen, das bearbeitet werden soll.</translation>
    </message>
    <message>
        <source>This DSM is a temporary file: its edits are gone when QGIS ends. Save the layer first.</source>
        <translation>Dieses DOM ist eine temporäre Datei: Seine Bearbeitungen sind weg, wenn QGIS endet. Den Layer zuerst speichern.</translation>
    </message>
    <message>
        <source>Hold the left button down and paint.</source>
        <translation>Mit gedrückter linker Maustaste malen.</translation>
    </message>
    <message>
        <source>Left click: a vertex. Right click: the shape is finished. Backspace: one vertex less. Esc: none.</source>
        <translation>Linksklick: ein Stützpunkt. Rechtsklick: Die Form ist fertig. Rücktaste: ein Stützpunkt weniger. Esc: keiner.</translation>
    </message>
    <message>
        <source>from the shore</source>
        <translation>vom Ufer</translation>
    </message>
    <message>
        <source>Making the edited DSM…</source>
        <translation>Das bearbeitete DOM entsteht…</translation>
    </message>
    <message>
        <source>The edited DSM could not be made.</source>
        <translation>Das bearbeitete DOM ist nicht entstanden.</translation>
    </message>
    <message>
        <source>The edit was taken back. {reason}</source>
        <translation>Die Bearbeitung wurde zurückgenommen. {reason}</translation>
    </message>
    <message>
        <source>Edited: {name}</source>
        <translation>Bearbeitet: {name}</translation>
    </message>
    <message>
        <source>Choose an edit, press Polygon or Brush, and draw on the map.</source>
        <translation>Eine Bearbeitung wählen, Polygon oder Pinsel drücken und auf der Karte zeichnen.</translation>
    </message>
    <message>
        <source>Edits in {file}: {count}.</source>
        <translation>Bearbeitungen in {file}: {count}.</translation>
    </message>
</context>
<context>
    <name>Tiles3d</name>
    <message>
        <source>Write a DSM or a point cloud as 3-D Tiles</source>
        <translation>DOM oder Punktwolke als 3-D Tiles schreiben</translation>
    </message>
    <message>
        <source>The surface or the points as a tileset for CesiumJS, QGIS and other viewers that show it on the globe.</source>
        <translation>Die Oberfläche oder die Punkte als Kachelsatz für CesiumJS, QGIS und andere Programme, die ihn auf dem Globus zeigen.</translation>
    </message>
    <message>
        <source>DSM or point cloud to write</source>
        <translation>DOM oder Punktwolke, die geschrieben werden</translation>
    </message>
    <message>
        <source>A raster of heights, in any CRS: a surface or a terrain model, of this plugin or of others. Or a point cloud (LAZ, LAS): its points are written, which QGIS does not draw, and CesiumJS does.</source>
        <translation>Ein Höhenraster in einem beliebigen KBS: ein Oberflächen- oder Geländemodell, von diesem Plugin oder von anderen. Oder eine Punktwolke (LAZ, LAS): Geschrieben werden ihre Punkte, die CesiumJS zeichnet und QGIS nicht.</translation>
    </message>
    <message>
        <source>Orthophoto</source>
        <translation>Orthophoto</translation>
    </message>
    <message>
        <source>A picture to drape over the surface, grey or in colour, in any CRS. Empty: a hillshade. For a point cloud: leave it empty, its points keep their own colours.</source>
        <translation>Ein Bild, das über die Oberfläche gelegt wird, grau oder farbig, in einem beliebigen KBS. Leer: eine Schummerung. Für eine Punktwolke leer lassen: Ihre Punkte behalten ihre eigenen Farben.</translation>
    </message>
</context>
<context>
    <name>Viewer</name>
    <message>
        <source>Show a DSM in the browser (3-D)</source>
        <translation>DOM im Browser zeigen (3D)</translation>
    </message>
    <message>
        <source>One HTML page with the surface in 3-D, what is draped over it, and profiles; needs no network.</source>
        <translation>Eine HTML-Seite mit der Oberfläche in 3D, den darübergelegten Rastern und Profilen; braucht kein Netz.</translation>
    </message>
    <message>
        <source>DSM to show</source>
        <translation>DOM, das gezeigt wird</translation>
    </message>
    <message>
        <source>A raster of heights, in any CRS: a surface or a terrain model, of this plugin or of others.</source>
        <translation>Ein Höhenraster in einem beliebigen KBS: ein Oberflächen- oder Geländemodell, von diesem Plugin oder von anderen.</translation>
    </message>
    <message>
        <source>Orthophoto</source>
        <translation>Orthophoto</translation>
    </message>
    <message>
        <source>A picture to drape over the surface, grey or in colour, in any CRS.</source>
        <translation>Ein Bild, das über die Oberfläche gelegt wird, grau oder farbig, in einem beliebigen KBS.</translation>
    </message>
    <message>
        <source>Confidence</source>
        <translation>Konfidenz</translation>
    </message>
    <message>
        <source>The confidence raster that came with the DSM, or one band with the expected error in metres.</source>
        <translation>Das Konfidenzraster, das mit dem DOM kam, oder ein Kanal mit dem erwarteten Fehler in Metern.</translation>
    </message>
    <message>
        <source>Height difference</source>
        <translation>Höhenunterschied</translation>
    </message>
    <message>
        <source>A raster of differences in metres, such as the height error of a comparison.</source>
        <translation>Ein Raster mit Unterschieden in Metern, etwa der Höhenfehler eines Vergleichs.</translation>
    </message>
    <message>
        <source>Most cells of the page</source>
        <translation>Höchstens so viele Zellen der Seite</translation>
    </message>
    <message>
        <source>Where the DSM has more, each cell of the page is a mean. A page of 4 million has 5 to 15 MB.</source>
        <translation>Hat das DOM mehr, ist jede Zelle der Seite ein Mittel. Eine Seite mit 4 Millionen hat 5 bis 15 MB.</translation>
    </message>
</context>
<context>
    <name>_ViewPanel</name>
    <message>
        <source>Not visible</source>
        <translation>Nicht sichtbar</translation>
    </message>
    <message>
        <source>Delete</source>
        <translation>Löschen</translation>
    </message>
    <message>
        <source>This image does not show the point (key S).</source>
        <translation>Dieses Bild zeigt den Punkt nicht (Taste S).</translation>
    </message>
    <message>
        <source>Remove the mark (key Delete).</source>
        <translation>Die Marke entfernen (Taste Entf).</translation>
    </message>
    <message>
        <source>Click: mark the point. Wheel, + and −: zoom. Drag: move the image. Arrow keys: move the mark by 0.1 px, with Shift by 1 px. Enter: the point is where it is predicted (yellow ring). Delete: remove the mark. S: not visible here. Home: back to the point.</source>
        <translation>Klick: den Punkt markieren. Rad, + und −: zoomen. Ziehen: das Bild verschieben. Pfeiltasten: die Marke um 0,1 px verschieben, mit Umschalt um 1 px. Eingabe: der Punkt liegt am vorhergesagten Ort (gelber Ring). Entf: die Marke entfernen. S: hier nicht sichtbar. Pos1: zurück zum Punkt.</translation>
    </message>
</context>
</TS>
