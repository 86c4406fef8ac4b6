"""Products in tiles, and folders and archives as they were delivered."""

import io
import os
import tarfile
import time
import zipfile

import numpy as np
import pytest
from osgeo import gdal

from repm_qgis.contracts.errors import ImageError, OptionError
from repm_qgis.contracts.options import EpmFitOptions, InspectOptions
from repm_qgis.imagery.deliveries import delivered, whole_of
from repm_qgis.imagery.raster import opened
from repm_qgis.rpc.writers import rpb_text, rpc_tags
from repm_qgis.scene import Scene, load_view
from repm_qgis.stages import run_stage

NAMES = [f"12FEB12053305-P1BS_R{row}C{col}-0527_01_P001.TIF" for row in (1, 2) for col in (1, 2)]
INDEX = "12FEB12053305-P1BS-0527_01_P001.TIL"


def cut(view, folder, names, sizes):
    """An image cut into 2 x 2 tiles without RPCs, named row by row."""
    (left, top), number = sizes, 0
    for row, height in ((0, top), (top, view.height - top)):
        for col, width in ((0, left), (left, view.width - left)):
            gdal.Translate(str(folder / names[number]), view.image, srcWin=[col, row, width, height])
            tile = gdal.Open(str(folder / names[number]), gdal.GA_Update)
            tile.SetMetadata(None, "RPC")
            tile = None  # noqa: F841
            number += 1


def maxar(view, folder, names=NAMES, index=INDEX):
    """A Basic product in four tiles as Maxar delivers it: TIL, IMD and RPB of the whole."""
    folder.mkdir(parents=True, exist_ok=True)
    left, top = 256, 240
    cut(view, folder, names, (left, top))
    groups = []
    for number, name in enumerate(names):
        row, col = divmod(number, 2)
        x = (0, left - 1) if col == 0 else (left, view.width - 1)
        y = (0, top - 1) if row == 0 else (top, view.height - 1)
        corners = {"UL": (x[0], y[0]), "UR": (x[1], y[0]), "LR": (x[1], y[1]), "LL": (x[0], y[1])}
        places = "".join(f"\t{k}ColOffset = {c};\n\t{k}RowOffset = {r};\n" for k, (c, r) in corners.items())
        groups.append(
            f'BEGIN_GROUP = TILE_{number + 1}\n\tfilename = "{name}";\n{places}END_GROUP = TILE_{number + 1}\n'
        )
    stem = index[:-4]
    (folder / index).write_text(f'bandId = "P";\nnumTiles = 4;\ntileSize = 256;\n{"".join(groups)}END;\n')
    facts = f"numRows = {view.height};\nnumColumns = {view.width};\nbitsPerPixel = 16;\n"
    facts += 'imageDescriptor = "Basic1B";\nsatId = "WV02";\n'
    (folder / f"{stem}.IMD").write_text(f'bandId = "P";\n{facts}\tfirstLineTime = 2012-02-12T05:33:05.000000Z;\nEND;\n')
    (folder / f"{stem}.RPB").write_text(rpb_text(view.rpc))
    return str(folder / index)


def without_rpc(view, path):
    """An image without any RPC."""
    path.parent.mkdir(parents=True, exist_ok=True)
    gdal.Translate(str(path), view.image)
    image = gdal.Open(str(path), gdal.GA_Update)
    image.SetMetadata(None, "RPC")
    image = None  # noqa: F841


def single(view, path):
    """An image with its RPC in a vendor's file beside it."""
    without_rpc(view, path)
    path.with_suffix(".RPB").write_text(rpb_text(view.rpc))
    return str(path)


def pixels_of(path):
    return gdal.Open(str(path)).ReadAsArray()


def test_any_tile_of_maxars_stands_for_the_whole_image(urban, tmp_path):
    view = urban.views[0]
    index = maxar(view, tmp_path)
    for name in NAMES:
        assert whole_of(str(tmp_path / name)) == index
    assert delivered([str(tmp_path / name) for name in NAMES]).images == (index,)
    whole = load_view(index)
    assert whole.size == view.size and whole.acquired.startswith("2012-02-12T05:33:05")
    np.testing.assert_array_equal(pixels_of(index), pixels_of(view.image))
    ground = view.localise(np.array([[10.0, 20.0], [300.0, 350.0]]), 200.0)
    assert np.abs(whole.project(ground) - view.project(ground)).max() < 1e-6


def test_a_tile_whose_neighbours_are_missing_is_an_image_of_its_own(urban, tmp_path):
    maxar(urban.views[0], tmp_path)
    os.unlink(tmp_path / NAMES[3])
    assert whole_of(str(tmp_path / NAMES[0])) == str(tmp_path / NAMES[0])
    assert whole_of(urban.images[0]) == urban.images[0]


def test_an_index_that_names_other_folders_is_not_followed(urban, tmp_path):
    maxar(urban.views[0], tmp_path)
    text = (tmp_path / INDEX).read_text().replace(NAMES[1], f"../{NAMES[1]}")
    (tmp_path / INDEX).write_text(text)
    assert delivered([str(tmp_path / NAMES[1])]).images == (str(tmp_path / NAMES[1]),)


CORE = "PHR1A_P_201304171037198_SEN_1-001"


def airbus(view, folder, core=CORE):
    """A Primary product in four tiles of 256 px as Airbus delivers it, with its DIMAP file; the tiles' names."""
    names = [f"IMG_{core}_R{row}C{col}.TIF" for row in (1, 2) for col in (1, 2)]
    cut(view, folder, names, (256, 256))
    files = "".join(
        f'<Data_File tile_R="{n // 2 + 1}" tile_C="{n % 2 + 1}"><DATA_FILE_PATH href="{name}"/></Data_File>'
        for n, name in enumerate(names)
    )
    tiling = '<Regular_Tiling><NTILES>4</NTILES><NTILES_SIZE ncols="256" nrows="256"/><NTILES_COUNT ntiles_R="2" '
    tiling += 'ntiles_C="2"/><OVERLAP_COL>0</OVERLAP_COL><OVERLAP_ROW>0</OVERLAP_ROW></Regular_Tiling>'
    (folder / f"DIM_{core}.XML").write_text(
        '<Dimap_Document><Metadata_Identification><METADATA_FORMAT version="2.0">DIMAP</METADATA_FORMAT>'
        f"</Metadata_Identification><Raster_Data><Data_Access><DATA_FILE_FORMAT>image/tiff</DATA_FILE_FORMAT>"
        f"<Data_Files>{files}</Data_Files></Data_Access><Raster_Dimensions><NROWS>{view.height}</NROWS>"
        f"<NCOLS>{view.width}</NCOLS><NBANDS>1</NBANDS><Tile_Set><NTILES>4</NTILES>{tiling}</Tile_Set>"
        "</Raster_Dimensions><Raster_Encoding><NBITS>16</NBITS></Raster_Encoding></Raster_Data></Dimap_Document>"
    )
    (folder / f"DIM_{core}.RPB").write_text(rpb_text(view.rpc))
    return names


def test_an_airbus_product_in_tiles_is_one_image(urban, tmp_path):
    view = urban.views[1]
    names = airbus(view, tmp_path)
    index = str(tmp_path / f"DIM_{CORE}.XML")
    assert delivered([str(tmp_path / name) for name in names]).images == (index,)
    whole = load_view(index)
    assert whole.size == view.size
    np.testing.assert_array_equal(pixels_of(index), pixels_of(view.image))


def test_a_folder_gives_panchromatic_images_and_sets_the_others_apart(urban, tmp_path, write_image):
    index = maxar(urban.views[0], tmp_path / "055_P1BS" / "P001_PAN")
    second = single(urban.views[1], tmp_path / "056_P1BS" / "13FEB12053305-P1BS-0528_01_P001.TIF")
    colours = write_image(tmp_path / "055_P1BS" / "ms.tif", np.ones((4, 90, 100), np.uint16), urban.views[0].rpc)
    write_image(tmp_path / "056_P1BS" / "13FEB-BROWSE.TIF")
    write_image(tmp_path / "no_rpc.tif")
    (tmp_path / "README.TXT").write_text("as delivered")
    found = delivered([str(tmp_path)])
    assert found.images == (index, second) and found.xs == (colours,)
    assert delivered([str(tmp_path), second]).images == (index, second)


def rpc_lines(rpc):
    """The keys and values of a text file with an RPC, a coefficient a line."""
    for key, value in rpc_tags(rpc).items():
        if key.endswith("_COEFF"):
            yield from ((f"{key}_{number}", each) for number, each in enumerate(value.split(), start=1))
        else:
            yield key, value


def test_halves_of_two_cameras_are_images_of_their_own(urban, tmp_path, write_image):
    """Names of GF-2's files: PMS1 and PMS2 see the left and the right half, with an RPC each; there is no index."""
    stems = [f"GF2_PMS{n}_E116.4_N39.9_20230522_L1A000729370{n}" for n in (1, 2)]
    images = []
    for number, (stem, view) in enumerate(zip(stems, urban.views), start=1):
        without_rpc(view, tmp_path / stem / f"{stem}-PAN{number}.tiff")
        (tmp_path / stem / f"{stem}-PAN{number}.rpb").write_text(rpb_text(view.rpc))
        facts = "<ProductMetaData><SatelliteID>GF2</SatelliteID></ProductMetaData>"
        (tmp_path / stem / f"{stem}-PAN{number}.xml").write_text(facts)
        write_image(tmp_path / stem / f"{stem}-MSS{number}.tiff", np.ones((4, 90, 100), np.uint16), view.rpc)
        images.append(str(tmp_path / stem / f"{stem}-PAN{number}.tiff"))
    found = delivered([str(tmp_path)])
    assert found.images == tuple(images) and len(found.xs) == 2


def test_a_folder_of_skysats_frames_gives_all_of_them(urban, tmp_path, write_image):
    """Names of SkySat's Basic L1A frames: the RPC beside each image, and a mask that is none."""
    images = []
    for number, view in enumerate(urban.views):
        path = tmp_path / f"20200101_101010_ssc{number}d1_000{number}_basic_l1a_panchromatic_dn.tif"
        without_rpc(view, path)
        lines = [f"{key}: {value}" for key, value in rpc_lines(view.rpc)]
        path.with_name(f"{path.stem}_RPC.TXT").write_text("\n".join(lines) + "\n")
        write_image(path.with_name(path.name.replace("panchromatic_dn", "panchromatic_udm2")))
        images.append(str(path))
    assert delivered([str(tmp_path)]).images == tuple(images)


def test_a_folder_of_colour_images_alone_gives_these(urban, tmp_path, write_image):
    colours = write_image(tmp_path / "ms.tif", np.ones((4, 90, 100), np.uint16), urban.views[0].rpc)
    assert delivered([str(tmp_path)]).images == (colours,)


def test_a_folder_without_images_says_so(tmp_path, write_image):
    with pytest.raises(ImageError, match="holds no image with an RPC: none of its files ends with .tif"):
        delivered([str(tmp_path)])
    write_image(tmp_path / "plain.tif")
    with pytest.raises(ImageError, match="holds no image with an RPC: No RPC found for"):
        delivered([str(tmp_path)])


def test_an_archive_is_read_without_unpacking(urban, tmp_path):
    for number, view in enumerate(urban.views[:2]):
        single(view, tmp_path / "in" / f"1{number}FEB12053305-P1BS-052{number}_01_P001.TIF")
    archive = tmp_path / "order.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted((tmp_path / "in").iterdir()):
            packed.write(file, f"order/{file.name}")
    found = delivered([str(archive)]).images
    assert len(found) == 2 and all(path.startswith("/vsizip/") for path in found)
    for view, path in zip(urban.views, found):
        again = load_view(path)
        assert again.size == view.size and again.acquired
        ground = view.localise(np.array([[10.0, 20.0], [300.0, 350.0]]), 200.0)
        assert np.abs(again.project(ground) - view.project(ground)).max() < 1e-6


def test_a_tar_file_is_read_without_unpacking(urban, tmp_path):
    maxar(urban.views[0], tmp_path / "in" / "a")
    single(urban.views[1], tmp_path / "in" / "b" / "13FEB12053305-P1BS-0528_01_P001.TIF")
    archive = tmp_path / "order.tar"
    with tarfile.open(archive, "w") as packed:
        packed.add(tmp_path / "in", "order")
    before = sorted(tmp_path.iterdir())
    found = delivered([str(archive)]).images
    root = f"/vsitar/{archive.as_posix()}/order"
    assert found == (f"{root}/a/{INDEX}", f"{root}/b/13FEB12053305-P1BS-0528_01_P001.TIF")
    for view, path in zip(urban.views, found):
        again = load_view(path)
        assert again.size == view.size and again.acquired
        np.testing.assert_array_equal(pixels_of(path), pixels_of(view.image))
        ground = view.localise(np.array([[10.0, 20.0], [300.0, 350.0]]), 200.0)
        assert np.abs(again.project(ground) - view.project(ground)).max() < 1e-6
    assert sorted(tmp_path.iterdir()) == before


def test_names_in_an_archive_that_lead_out_and_links_are_not_followed(urban, tmp_path):
    outside = single(urban.views[0], tmp_path / "outside" / "a.tif")
    for name, link in (("../outside/a.tif", None), ("b.tif", outside)):
        with tarfile.open(tmp_path / "order.tar", "w") as packed:
            member = tarfile.TarInfo(name)
            if link is None:
                member.size = os.path.getsize(outside)
                with open(outside, "rb") as stream:
                    packed.addfile(member, stream)
            else:
                member.type, member.linkname = tarfile.SYMTYPE, link
                packed.addfile(member)
            packed.addfile(tarfile.TarInfo("readme.txt"), io.BytesIO())
        gdal.VSICurlClearCache()
        with pytest.raises(ImageError, match="order.tar' holds no image with an RPC"):
            delivered([str(tmp_path / "order.tar")])


@pytest.mark.parametrize("name", ["order.tar.gz", "ORDER.TGZ", "order.7z"])
def test_an_archive_that_is_compressed_as_a_whole_is_refused_with_the_remedy(tmp_path, name, told):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(ImageError, match=f"{name}' is compressed as a whole, .*: unpack it, and choose its folder.$"):
        run_stage("epmfit", {"images": [str(tmp_path / name)], "workspace": str(tmp_path / "ws")}, told())
    assert [path.name for path in tmp_path.iterdir()] == [name], "nothing was unpacked"


def test_tiles_in_an_archive_are_one_image(urban, tmp_path):
    maxar(urban.views[0], tmp_path / "in" / "055_P1BS")
    airbus(urban.views[1], tmp_path / "in")
    archive = tmp_path / "order.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(file for file in (tmp_path / "in").rglob("*") if file.is_file()):
            packed.write(file, file.relative_to(tmp_path / "in").as_posix())
    root = f"/vsizip/{archive.as_posix()}"
    found = delivered([str(archive)]).images
    assert found == (f"{root}/055_P1BS/{INDEX}", f"{root}/DIM_{CORE}.XML")
    for view, path in zip(urban.views, found):
        again = load_view(path)
        assert again.size == view.size
        np.testing.assert_array_equal(pixels_of(path), pixels_of(view.image))
        ground = view.localise(np.array([[10.0, 20.0], [300.0, 350.0]]), 200.0)
        assert np.abs(again.project(ground) - view.project(ground)).max() < 1e-6


VRT = '<VRTDataset rasterXSize="2" rasterYSize="2"/>'


@pytest.mark.parametrize("kind", ["a network path", "another index", "a tile that is a description"])
@pytest.mark.parametrize("vendor", ["airbus", "maxar"])
def test_an_index_in_an_archive_leads_nowhere_else(urban, tmp_path, kind, vendor):
    names = airbus(urban.views[1], tmp_path) if vendor == "airbus" else NAMES
    index = tmp_path / (f"DIM_{CORE}.XML" if vendor == "airbus" else os.path.basename(maxar(urban.views[0], tmp_path)))
    if kind == "a network path":
        index.write_text(index.read_text().replace(f'"{names[3]}"', '"/vsicurl/http://localhost:9/x.tif"'))
    elif kind == "another index":
        component = '<COMPONENT_TYPE>DIMAP</COMPONENT_TYPE><COMPONENT_PATH href="b.xml"/>'
        index.write_text(index.read_text() + component)
    else:
        (tmp_path / names[3]).write_text(VRT)
    archive = tmp_path / "order.zip"
    with zipfile.ZipFile(archive, "w") as packed:
        for file in (index, *(tmp_path / name for name in names)):
            packed.write(file, file.name)
    with pytest.raises(ImageError, match="is a description in an archive: unpack the archive"):
        with opened(f"/vsizip/{archive.as_posix()}/{index.name}"):
            pass


def test_one_folder_is_enough_for_the_stages(urban, tmp_path, told):
    maxar(urban.views[0], tmp_path / "order" / "a")
    single(urban.views[1], tmp_path / "order" / "b" / "13FEB12053305-P1BS-0528_01_P001.TIF")
    said = told()
    run_stage("epmfit", {"images": [str(tmp_path / "order")], "workspace": str(tmp_path / "ws")}, said)
    views = Scene.load(str(tmp_path / "ws" / "scene.json")).views
    assert [view.size for view in views] == [view.size for view in urban.views[:2]]
    assert any("stands for 2 images" in note for note in said.notes)
    page = str(tmp_path / "inspect.html")
    made = run_stage("inspect", {"images": [str(tmp_path / "order")], "report": page}, told())
    assert (made.n_images, made.n_pairs) == (2, 1)


def test_lists_beside_a_folder_cannot_be_in_its_order(urban, tmp_path, told):
    single(urban.views[0], tmp_path / "order" / "a.tif")
    single(urban.views[1], tmp_path / "order" / "b.tif")
    options = {"images": [str(tmp_path / "order")], "workspace": str(tmp_path / "ws"), "rpcs": [urban.images[0]]}
    with pytest.raises(OptionError, match="RPCS .* must be empty where a folder"):
        run_stage("epmfit", options, told())


def test_one_image_in_a_folder_is_not_enough(urban, tmp_path, told):
    single(urban.views[0], tmp_path / "order" / "a.tif")
    with pytest.raises(OptionError, match="must name at least two images"):
        options = {"workspace": str(tmp_path / "ws"), "output": str(tmp_path / "dsm.tif")}
        run_stage("pipeline", {"images": [str(tmp_path / "order")], **options}, told())
    assert not (tmp_path / "ws").exists()
    with pytest.raises(OptionError, match="must name an image"):
        EpmFitOptions(images=(), workspace="ws")
    assert InspectOptions(images=(str(tmp_path),)).images == (str(tmp_path),)


def test_an_archive_of_many_names_is_refused_at_once(tmp_path):
    path = str(tmp_path / "many.zip")
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(30_000):
            archive.writestr(f"{number}.tif", b"")
    begin = time.process_time()
    with pytest.raises(ImageError, match="many.zip' holds more than 20000 files: choose the folder of one product"):
        delivered([path])
    assert time.process_time() - begin < 1.0
