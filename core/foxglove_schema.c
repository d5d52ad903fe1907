/* The shapes of the messages as JSON schemas: names and types as Foxglove publishes them. */
#include "core/foxglove.h"

#define FIELD(name, schema) "\"" name "\":" schema
#define AND ","
#define OBJECT(title, required, fields)                                                                      \
    "{\"title\":\"" title "\",\"type\":\"object\",\"required\":[" required "],\"properties\":{" fields "}}"
#define ARRAY(items) "{\"type\":\"array\",\"items\":" items "}"
#define Q(name) "\"" name "\""

#define NUMBER "{\"type\":\"number\"}"
#define INTEGER "{\"type\":\"integer\"}"
#define COUNT "{\"type\":\"integer\",\"minimum\":0}"
#define STRING "{\"type\":\"string\"}"
#define BOOLEAN "{\"type\":\"boolean\"}"
#define BYTES "{\"type\":\"string\",\"contentEncoding\":\"base64\"}"
#define NANOSECONDS "{\"type\":\"integer\",\"minimum\":0,\"maximum\":999999999}"
#define CHOICE(title, list) "{\"title\":\"" title "\",\"oneOf\":[" list "]}"
#define CASE(title, value) "{\"title\":\"" title "\",\"const\":" value "}"

#define TIME OBJECT("time", Q("sec") AND Q("nsec"), FIELD("sec", COUNT) AND FIELD("nsec", NANOSECONDS))
#define DURATION                                                                                             \
    OBJECT("duration", Q("sec") AND Q("nsec"), FIELD("sec", INTEGER) AND FIELD("nsec", NANOSECONDS))
#define XYZ                                                                                                  \
    FIELD("x", NUMBER) AND FIELD("y", NUMBER)                                                                \
    AND FIELD("z", NUMBER)
#define REQUIRED_XYZ Q("x") AND Q("y") AND Q("z")
#define VECTOR2 OBJECT("foxglove.Vector2", Q("x") AND Q("y"), FIELD("x", NUMBER) AND FIELD("y", NUMBER))
#define VECTOR3 OBJECT("foxglove.Vector3", REQUIRED_XYZ, XYZ)
#define POINTS ARRAY(OBJECT("foxglove.Point3", REQUIRED_XYZ, XYZ))
#define QUATERNION OBJECT("foxglove.Quaternion", REQUIRED_XYZ AND Q("w"), XYZ AND FIELD("w", NUMBER))
#define POSE                                                                                                 \
    OBJECT("foxglove.Pose", Q("position") AND Q("orientation"),                                              \
           FIELD("position", VECTOR3) AND FIELD("orientation", QUATERNION))
#define COLOR                                                                                                \
    OBJECT("foxglove.Color", Q("r") AND Q("g") AND Q("b") AND Q("a"),                                        \
           FIELD("r", NUMBER) AND FIELD("g", NUMBER) AND FIELD("b", NUMBER) AND FIELD("a", NUMBER))
#define PACKED_FIELDS                                                                                        \
    ARRAY(OBJECT("foxglove.PackedElementField", Q("name") AND Q("offset") AND Q("type"),                     \
                 FIELD("name", STRING) AND FIELD("offset", COUNT) AND FIELD(                                 \
                     "type", CHOICE("foxglove.NumericType",                                                  \
                                    CASE("UNKNOWN", "0") AND CASE("UINT8", "1") AND CASE("INT8", "2")        \
                                        AND CASE("UINT16", "3") AND CASE("INT16", "4")                       \
                                            AND CASE("UINT32", "5") AND CASE("INT32", "6")                   \
                                                AND CASE("FLOAT32", "7") AND CASE("FLOAT64", "8")))))

/* clang-format off */
static const char transforms[] =
    OBJECT("foxglove.FrameTransforms", Q("transforms"),
        FIELD("transforms", ARRAY(OBJECT("foxglove.FrameTransform",
            Q("timestamp") AND Q("parent_frame_id") AND Q("child_frame_id") AND Q("translation") AND Q("rotation"),
            FIELD("timestamp", TIME) AND FIELD("parent_frame_id", STRING) AND FIELD("child_frame_id", STRING) AND
            FIELD("translation", VECTOR3) AND FIELD("rotation", QUATERNION)))));

static const char pose[] =
    OBJECT("foxglove.PoseInFrame", Q("timestamp") AND Q("frame_id") AND Q("pose"),
        FIELD("timestamp", TIME) AND FIELD("frame_id", STRING) AND FIELD("pose", POSE));

#define SOLID(title) ARRAY(OBJECT(title, Q("pose") AND Q("size") AND Q("color"), \
    FIELD("pose", POSE) AND FIELD("size", VECTOR3) AND FIELD("color", COLOR)))
static const char scene[] =
    OBJECT("foxglove.SceneUpdate", Q("deletions") AND Q("entities"),
        FIELD("deletions", ARRAY(OBJECT("foxglove.SceneEntityDeletion",
            Q("timestamp") AND Q("type") AND Q("id"),
            FIELD("timestamp", TIME) AND
            FIELD("type", CHOICE("foxglove.SceneEntityDeletionType", CASE("MATCHING_ID", "0") AND CASE("ALL", "1"))) AND
            FIELD("id", STRING)))) AND
        FIELD("entities", ARRAY(OBJECT("foxglove.SceneEntity",
            Q("timestamp") AND Q("frame_id") AND Q("id") AND Q("lifetime") AND Q("frame_locked") AND Q("metadata") AND
            Q("arrows") AND Q("cubes") AND Q("spheres") AND Q("cylinders") AND Q("lines") AND Q("triangles") AND
            Q("texts") AND Q("models"),
            FIELD("timestamp", TIME) AND FIELD("frame_id", STRING) AND FIELD("id", STRING) AND
            FIELD("lifetime", DURATION) AND FIELD("frame_locked", BOOLEAN) AND
            FIELD("metadata", ARRAY(OBJECT("foxglove.KeyValuePair", Q("key") AND Q("value"),
                FIELD("key", STRING) AND FIELD("value", STRING)))) AND
            FIELD("arrows", ARRAY(OBJECT("foxglove.ArrowPrimitive",
                Q("pose") AND Q("shaft_length") AND Q("shaft_diameter") AND Q("head_length") AND Q("head_diameter") AND
                Q("color"),
                FIELD("pose", POSE) AND FIELD("shaft_length", NUMBER) AND FIELD("shaft_diameter", NUMBER) AND
                FIELD("head_length", NUMBER) AND FIELD("head_diameter", NUMBER) AND FIELD("color", COLOR)))) AND
            FIELD("cubes", SOLID("foxglove.CubePrimitive")) AND
            FIELD("spheres", SOLID("foxglove.SpherePrimitive")) AND
            FIELD("cylinders", ARRAY(OBJECT("foxglove.CylinderPrimitive",
                Q("pose") AND Q("size") AND Q("bottom_scale") AND Q("top_scale") AND Q("color"),
                FIELD("pose", POSE) AND FIELD("size", VECTOR3) AND FIELD("bottom_scale", NUMBER) AND
                FIELD("top_scale", NUMBER) AND FIELD("color", COLOR)))) AND
            FIELD("lines", ARRAY(OBJECT("foxglove.LinePrimitive",
                Q("type") AND Q("pose") AND Q("thickness") AND Q("scale_invariant") AND Q("points") AND Q("color") AND
                Q("colors") AND Q("indices"),
                FIELD("type", CHOICE("foxglove.LineType",
                    CASE("LINE_STRIP", "0") AND CASE("LINE_LOOP", "1") AND CASE("LINE_LIST", "2"))) AND
                FIELD("pose", POSE) AND FIELD("thickness", NUMBER) AND FIELD("scale_invariant", BOOLEAN) AND
                FIELD("points", POINTS) AND FIELD("color", COLOR) AND FIELD("colors", ARRAY(COLOR)) AND
                FIELD("indices", ARRAY(COUNT))))) AND
            FIELD("triangles", ARRAY(OBJECT("foxglove.TriangleListPrimitive",
                Q("pose") AND Q("points") AND Q("color") AND Q("colors") AND Q("indices"),
                FIELD("pose", POSE) AND FIELD("points", POINTS) AND FIELD("color", COLOR) AND
                FIELD("colors", ARRAY(COLOR)) AND FIELD("indices", ARRAY(COUNT))))) AND
            FIELD("texts", ARRAY(OBJECT("foxglove.TextPrimitive",
                Q("pose") AND Q("billboard") AND Q("font_size") AND Q("scale_invariant") AND Q("color") AND Q("text"),
                FIELD("pose", POSE) AND FIELD("billboard", BOOLEAN) AND FIELD("font_size", NUMBER) AND
                FIELD("scale_invariant", BOOLEAN) AND FIELD("color", COLOR) AND FIELD("text", STRING)))) AND
            FIELD("models", ARRAY(OBJECT("foxglove.ModelPrimitive",
                Q("pose") AND Q("scale") AND Q("color") AND Q("override_color") AND Q("url") AND Q("media_type") AND
                Q("data"),
                FIELD("pose", POSE) AND FIELD("scale", VECTOR3) AND FIELD("color", COLOR) AND
                FIELD("override_color", BOOLEAN) AND FIELD("url", STRING) AND FIELD("media_type", STRING) AND
                FIELD("data", BYTES))))))));

static const char grid[] =
    OBJECT("foxglove.Grid",
        Q("timestamp") AND Q("frame_id") AND Q("pose") AND Q("column_count") AND Q("cell_size") AND
        Q("row_stride") AND Q("cell_stride") AND Q("fields") AND Q("data"),
        FIELD("timestamp", TIME) AND FIELD("frame_id", STRING) AND FIELD("pose", POSE) AND
        FIELD("column_count", COUNT) AND FIELD("cell_size", VECTOR2) AND FIELD("row_stride", COUNT) AND
        FIELD("cell_stride", COUNT) AND FIELD("fields", PACKED_FIELDS) AND FIELD("data", BYTES));

static const char text[] =
    OBJECT("foxglove.Log",
        Q("timestamp") AND Q("level") AND Q("message") AND Q("name") AND Q("file") AND Q("line"),
        FIELD("timestamp", TIME) AND
        FIELD("level", CHOICE("foxglove.LogLevel",
            CASE("UNKNOWN", "0") AND CASE("DEBUG", "1") AND CASE("INFO", "2") AND CASE("WARNING", "3") AND
            CASE("ERROR", "4") AND CASE("FATAL", "5"))) AND
        FIELD("message", STRING) AND FIELD("name", STRING) AND FIELD("file", STRING) AND FIELD("line", COUNT));

static const char image[] =
    OBJECT("foxglove.CompressedImage", Q("timestamp") AND Q("frame_id") AND Q("data") AND Q("format"),
        FIELD("timestamp", TIME) AND FIELD("frame_id", STRING) AND FIELD("data", BYTES) AND FIELD("format", STRING));

static const char cloud[] =
    OBJECT("foxglove.PointCloud",
        Q("timestamp") AND Q("frame_id") AND Q("pose") AND Q("point_stride") AND Q("fields") AND Q("data"),
        FIELD("timestamp", TIME) AND FIELD("frame_id", STRING) AND FIELD("pose", POSE) AND
        FIELD("point_stride", COUNT) AND FIELD("fields", PACKED_FIELDS) AND FIELD("data", BYTES));

/* Positions in rad or m, rates per second, forces in N, or N m where no cylinder drives the joint. */
static const char joints[] =
    OBJECT("teledimos.JointStates", Q("timestamp") AND Q("joints"),
        FIELD("timestamp", TIME) AND
        FIELD("joints", ARRAY(OBJECT("teledimos.JointState",
            Q("name") AND Q("position") AND Q("rate") AND Q("force"),
            FIELD("name", STRING) AND FIELD("position", NUMBER) AND FIELD("rate", NUMBER) AND
            FIELD("force", NUMBER)))));
/* clang-format on */

td_mcap_channel td_foxglove_channel(td_foxglove_kind kind, const char *topic)
{
    static const struct {
        const char *name, *schema;
        size_t size;
    } about[TD_FOXGLOVE_KIND_COUNT] = {
        [TD_FOXGLOVE_TRANSFORMS] = {"foxglove.FrameTransforms", transforms, sizeof transforms - 1},
        [TD_FOXGLOVE_POSE] = {"foxglove.PoseInFrame", pose, sizeof pose - 1},
        [TD_FOXGLOVE_SCENE] = {"foxglove.SceneUpdate", scene, sizeof scene - 1},
        [TD_FOXGLOVE_GRID] = {"foxglove.Grid", grid, sizeof grid - 1},
        [TD_FOXGLOVE_LOG] = {"foxglove.Log", text, sizeof text - 1},
        [TD_FOXGLOVE_IMAGE] = {"foxglove.CompressedImage", image, sizeof image - 1},
        [TD_FOXGLOVE_CLOUD] = {"foxglove.PointCloud", cloud, sizeof cloud - 1},
        [TD_FOXGLOVE_JOINTS] = {"teledimos.JointStates", joints, sizeof joints - 1},
    };
    return (td_mcap_channel){topic,           "json", about[kind].name, "jsonschema", about[kind].schema,
                             about[kind].size};
}
