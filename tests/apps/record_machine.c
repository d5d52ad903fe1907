/* For test_mcap.py: writes a recording that holds every kind of message, and lists the messages of any file.
 *   record_machine write OUT URDF
 *   record_machine list FILE            topic, time, sequence, bytes in hexadecimal, a line each */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/foxglove.h"
#include "core/image.h"

typedef struct recorder {
    td_mcap_writer *writer;
    int channel[TD_FOXGLOVE_KIND_COUNT];
    td_error error;
} recorder;

static td_status keep(recorder *r, td_foxglove_kind kind, td_status status, char *json, size_t size,
                      uint64_t ns)
{
    if (status == TD_OK) status = td_mcap_write(r->writer, r->channel[kind], ns, json, size, &r->error);
    free(json);
    return status;
}

static td_status begin(recorder *r, const char *path)
{
    static const char *const topic[TD_FOXGLOVE_KIND_COUNT] = {"/tf",  "/pose",  "/machine", "/map",
                                                              "/log", "/image", "/cloud",   "/joints"};
    const td_mcap_options options = {20000};
    TD_TRY(td_mcap_writer_new(&r->writer, path, &options, &r->error));
    for (int i = 0; i < TD_FOXGLOVE_KIND_COUNT; i++) {
        const td_mcap_channel about = td_foxglove_channel((td_foxglove_kind)i, topic[i]);
        TD_TRY(td_mcap_channel_add(r->writer, &r->channel[i], &about, &r->error));
    }
    return TD_OK;
}

/* What stands still: the machine's shapes, a map of a slope with a hole, a cloud, a picture. */
static td_status still(recorder *r, const td_robot *robot)
{
    const double yellow[] = {0.9, 0.7, 0.1, 1}, origin[] = {3, -2};
    char *json;
    size_t size, byte_count;
    td_elevation *map;
    td_cloud *cloud;
    td_image *image;
    uint8_t *bytes;
    td_status status = td_foxglove_machine(&json, &size, robot, yellow, 0, &r->error);
    TD_TRY(keep(r, TD_FOXGLOVE_SCENE, status, json, size, 0));
    TD_TRY(td_elevation_new(&map, 6, 5, 0.5, origin, "site", &r->error));
    for (int i = 0; i < 30; i++) {
        map->height[i] = i == 7 ? NAN : 0.125F * (float)(i % 6);
        map->sigma[i] = 0.01F;
    }
    status = td_foxglove_grid(&json, &size, map, 0, &r->error);
    td_elevation_free(&map);
    TD_TRY(keep(r, TD_FOXGLOVE_GRID, status, json, size, 0));
    TD_TRY(td_cloud_new(&cloud, 4, 0, &r->error));
    for (int i = 0; i < 4; i++)
        cloud->point[i] = (td_cloud_point){{100 + i, 0.5 * i, -i}, 0.02F, {255, 128, 0}};
    status = td_foxglove_cloud(&json, &size, cloud, "site", 0, &r->error);
    td_cloud_free(&cloud);
    TD_TRY(keep(r, TD_FOXGLOVE_CLOUD, status, json, size, 0));
    TD_TRY(td_image_new(&image, 8, 4, 1, &r->error));
    status = td_image_encode_png(&bytes, &byte_count, image, &r->error);
    td_image_free(&image);
    TD_TRY(status);
    status = td_foxglove_image(&json, &size, bytes, byte_count, "png", "left", 0, &r->error);
    free(bytes);
    return keep(r, TD_FOXGLOVE_IMAGE, status, json, size, 0);
}

static td_status moving(recorder *r, const td_robot *robot, int frame)
{
    td_plant_state state = {.time_s = 0.05 * frame, .site_from_vehicle = td_pose_identity()};
    uint64_t ns;
    char *json, text[64];
    size_t size;
    state.site_from_vehicle.t[0] = 0.1 * state.time_s;
    for (int i = 0; i < robot->joint_count; i++) {
        state.q[i] = 0.2 * sin(state.time_s + i);
        state.dq[i] = 0.2 * cos(state.time_s + i);
        state.force[i] = 1e5 * state.q[i];
    }
    if (!td_mcap_time(&ns, state.time_s)) return TD_ERROR_ARGUMENT;
    td_status status =
        td_foxglove_transforms(&json, &size, robot, state.q, "site", &state.site_from_vehicle, ns, &r->error);
    TD_TRY(keep(r, TD_FOXGLOVE_TRANSFORMS, status, json, size, ns));
    status = td_foxglove_joints(&json, &size, robot, &state, ns, &r->error);
    TD_TRY(keep(r, TD_FOXGLOVE_JOINTS, status, json, size, ns));
    status = td_foxglove_pose(&json, &size, &state.site_from_vehicle, "site", ns, &r->error);
    TD_TRY(keep(r, TD_FOXGLOVE_POSE, status, json, size, ns));
    snprintf(text, sizeof text, "frame %d: \"böse\" \\ text\n", frame);
    status = td_foxglove_log(&json, &size, TD_LOG_WARNING, "test", text, ns, &r->error);
    return keep(r, TD_FOXGLOVE_LOG, status, json, size, ns);
}

static td_status write_all(recorder *r, const char *path, const char *urdf)
{
    td_robot *robot = NULL;
    td_status status = td_robot_read(&robot, urdf, &r->error);
    if (status == TD_OK) status = begin(r, path);
    if (status == TD_OK) status = still(r, robot);
    for (int i = 0; status == TD_OK && i < 100; i++) status = moving(r, robot, i);
    if (status == TD_OK) status = td_mcap_finish(&r->writer, &r->error);
    td_mcap_writer_free(&r->writer);
    td_robot_free(&robot);
    return status;
}

static td_status list(const char *path, td_error *error)
{
    td_mcap_reader *reader = NULL;
    td_mcap_message m;
    bool more = true;
    TD_TRY(td_mcap_open(&reader, path, 0, error));
    td_status status = td_mcap_next(reader, &m, &more, error);
    for (; status == TD_OK && more; status = td_mcap_next(reader, &m, &more, error)) {
        printf("%s %llu %lu ", td_mcap_about(reader)->channel[m.channel].topic,
               (unsigned long long)m.log_time_ns, (unsigned long)m.sequence);
        for (size_t i = 0; i < m.size; i++) printf("%02x", ((const unsigned char *)m.data)[i]);
        putchar('\n');
    }
    td_mcap_free(&reader);
    return status;
}

int main(int argc, char **argv)
{
    recorder r = {0};
    td_status status = TD_ERROR_ARGUMENT;
    if (argc == 4 && strcmp(argv[1], "write") == 0) status = write_all(&r, argv[2], argv[3]);
    if (argc == 3 && strcmp(argv[1], "list") == 0) status = list(argv[2], &r.error);
    if (status != TD_OK) fprintf(stderr, "%s\n", r.error.message);
    return status == TD_OK ? 0 : 1;
}
