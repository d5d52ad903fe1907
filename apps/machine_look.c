/* Images of the machine's stereo head, rendered aside: what the head sees of the ground as it truly is, and
 * of the machine as it truly stands. They go on a link of their own, and only when the last one has gone: at
 * a low rate, or a pair without loss when it is asked for. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_internal.h"
#include "sim/stereo_view.h"

enum { QUALITY = 85 };

static td_status take_head(machine *m, td_error *error)
{
    const machine_options *o = m->o;
    if (m->s->ground.site[0] && !o->rig) {
        TD_TRY(td_scene_read(&m->scene_file, m->s->ground.site, error));
        m->scene = m->scene_file->scene;
        m->mount = m->scene_file->mount_link;
        if (m->rehearsal) return machine_truth_rig(&m->rig, m, error);
        m->rig = m->scene_file->rig;
        if (!m->rig->has_vehicle) m->rig->vehicle_from_rig = m->scene_file->mount_from_rig;
        return TD_OK;
    }
    if (!o->rig) return TD_OK;
    TD_TRY(td_rig_read(&m->rig, o->rig, error));
    m->mount = o->mount ? td_robot_find_link(m->s->robot, o->mount) : 0;
    if (m->mount < 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "--mount %s: the robot has no such link", o->mount);
    if (!m->rig->has_vehicle)
        return td_fail(error, TD_ERROR_DATA,
                       "%s: does not say how it is mounted: vehicle_from_rig is missing", o->rig);
    m->scene = (td_scene){
        .ground_surface = {.albedo = 0.4, .contrast = 0.3, .grain_m = 0.5, .octaves = 8, .seed = 3},
        .robot_surface = {.albedo = 0.7},
        .sun = {0.48, 0.36, 0.8},
        .ambient = 0.35};
    return TD_OK;
}

td_status machine_look_begin(machine *m, td_error *error)
{
    m->mount = m->wanted = -1;
    if (m->o->image_hz > 0 || m->rehearsal) TD_TRY(take_head(m, error));
    m->next_look_s = td_machine_now_s();
    return TD_OK;
}

void machine_look_end(machine *m)
{
    aside_free(&m->look);
    if (!m->scene_file || m->rehearsal) td_rig_free(&m->rig); /* else it is the scene's */
    td_scene_free(&m->scene_file);
}

/* ---- aside ---- */

typedef struct picture {
    double time_s;
    int side, width, height;
    td_pose site_from_vehicle;
    double q[TD_ROBOT_MAX_JOINTS];
    size_t size; /* of the JPEG that follows */
} picture;

static td_view_options how_to_see(const machine *m)
{
    td_view_options o = td_view_options_default();
    o.samples = 1; /* a fourth of the time */
    o.gain = 1.6;
    if (m->wanted >= 0 && m->scene_file) {
        o = td_view_options_of_scene(&m->scene_file->image);
        o.seed = (uint64_t)m->o->common->seed;
    }
    o.threads = 1;
    return o;
}

/* `reads`: the machine as it says that it stands. */
static td_status give_side(machine *m, const td_stereo_view *view, int side, const td_pose *site_from_rig,
                           const td_plant_state *reads, FILE *out, td_error *error)
{
    const td_view_options o = how_to_see(m);
    td_view *seen = NULL;
    uint8_t *jpeg = NULL;
    picture p = {.time_s = m->state.time_s, .side = side, .site_from_vehicle = reads->site_from_vehicle};
    td_status status = td_stereo_view_render(&seen, view, m->rig, side, site_from_rig, m->looks, &o, error);
    if (status == TD_OK && m->wanted >= 0)
        status = td_image_encode_png(&jpeg, &p.size, seen->image, error);
    else if (status == TD_OK)
        status = td_image_encode_jpeg(&jpeg, &p.size, seen->image, QUALITY, error);
    if (status == TD_OK) {
        p.width = seen->image->width;
        p.height = seen->image->height;
        memcpy(p.q, reads->q, sizeof p.q);
        if (fwrite(&p, sizeof p, 1, out) != 1 || fwrite(jpeg, 1, p.size, out) != p.size)
            status = td_fail(error, TD_ERROR_IO, "the pipe is closed");
    }
    free(jpeg);
    td_view_free(&seen);
    return status;
}

/* Where it stands, or stood as it came, before the ground was touched. */
static td_status stands(td_plant_state *truly, td_plant_state *reads, const td_elevation **map, machine *m,
                        td_error *error)
{
    TD_TRY(station_map(map, m->station, error));
    TD_TRY(m->plant.state(m->plant.self, truly, error));
    *reads = m->state;
    if (m->wanted <= 0) return TD_OK;
    if (!m->scene_file || (size_t)m->wanted > m->scene_file->frame_count)
        return td_fail(error, TD_ERROR_DATA, "it did not look %d times as it came", m->wanted);
    const td_scene_frame *frame = m->scene_file->frame + m->wanted - 1;
    *map = station_first_map(m->station);
    truly->site_from_vehicle = reads->site_from_vehicle = frame->site_from_vehicle;
    for (int k = 0; k < m->s->robot->joint_count; k++) {
        reads->q[k] = frame->q[k];
        truly->q[k] = frame->q[k] - m->zero[k];
    }
    return TD_OK;
}

static td_status look_around(machine *m, FILE *out, td_error *error)
{
    const td_elevation *map = NULL;
    td_stereo_view *view = NULL;
    td_plant_state state, reads;
    td_pose root_from_link[TD_ROBOT_MAX_LINKS];
    TD_TRY(stands(&state, &reads, &map, m, error));
    m->scene.ground = (td_elevation *)(uintptr_t)map; /* only looked at */
    m->scene.robot = m->robot_true;
    m->scene.site_from_vehicle = state.site_from_vehicle;
    memcpy(m->scene.q, state.q, sizeof m->scene.q);
    td_robot_forward(root_from_link, m->robot_true, state.q);
    td_pose at = td_pose_compose(&state.site_from_vehicle, &root_from_link[m->mount < 0 ? 0 : m->mount]);
    at = td_pose_compose(&at, &m->rig->vehicle_from_rig);
    td_status status = td_stereo_view_new(&view, &m->scene, error);
    for (int side = 0; side < 2 && side < m->rig->count && status == TD_OK; side++)
        status = give_side(m, view, side, &at, &reads, out, error);
    td_stereo_view_free(&view);
    return status;
}

/* What failed comes as a picture of no size, with the sentence behind it. */
static bool work(void *user, FILE *out)
{
    td_error error = {0};
    if (look_around(user, out, &error) == TD_OK) return true;
    const picture none = {.size = strlen(error.message)};
    return fwrite(&none, sizeof none, 1, out) == 1 && fwrite(error.message, 1, none.size, out) == none.size;
}

/* ---- sent ---- */

static void send_pictures(machine *m, const char *bytes, size_t size)
{
    while (m->pictures && size >= sizeof(picture)) {
        picture p;
        td_error error = {0};
        td_machine_message message = {.kind = TD_MACHINE_IMAGE};
        memcpy(&p, bytes, sizeof p);
        if (p.size > size - sizeof p) return;
        if (p.width == 0) {
            audit_line(&m->audit, "trouble", NULL, "no image: %.*s", (int)p.size, bytes + sizeof p);
            return;
        }
        message.as.image = (td_machine_image){.time_s = p.time_s,
                                              .side = p.side,
                                              .width = p.width,
                                              .height = p.height,
                                              .site_from_vehicle = p.site_from_vehicle,
                                              .joints = m->s->robot->joint_count,
                                              .jpeg = (const uint8_t *)bytes + sizeof p,
                                              .size = p.size};
        memcpy(message.as.image.q, p.q, sizeof p.q);
        if (td_machine_send(m->pictures, &message, true, &error) != TD_OK)
            audit_line(&m->audit, "trouble", NULL, "%s", error.message);
        bytes += sizeof p + p.size;
        size -= sizeof p + p.size;
    }
}

/* No picture is worth the machine: what cannot be taken is told, and left out. */
void machine_look(machine *m)
{
    size_t size = 0;
    td_error error = {0};
    if (m->look) {
        if (!aside_poll(m->look)) return;
        const char *bytes = aside_bytes(m->look, &size);
        if (bytes)
            send_pictures(m, bytes, size);
        else
            audit_line(&m->audit, "trouble", NULL, "an image could not be rendered");
        aside_free(&m->look);
    }
    const double now = td_machine_now_s();
    const bool asked = m->wanted >= 0, due = m->o->image_hz > 0 && now >= m->next_look_s;
    if (!m->rig || !m->pictures || !(due || asked) || td_link_unsent(m->pictures)) return;
    m->next_look_s = now + 1 / m->o->image_hz;
    m->looks++;
    if (aside_begin(&m->look, work, m, asked ? 0 : 10, &error) != TD_OK)
        audit_line(&m->audit, "trouble", NULL, "no image: %s", error.message);
    m->wanted = -1; /* it sees what was wanted as it began */
}
