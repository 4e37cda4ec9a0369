// An equirectangular environment behind everything (see `render.environment`).
uniform sampler2D panorama;
uniform mat3 toward_from_window;
uniform mat3 light_from_world;
uniform float azimuth_rad;

layout(location = 0) out vec4 radiance;

const float PI = 3.14159265358979;

void main() {
    vec3 away = normalize(-light_from_world * (toward_from_window * vec3(gl_FragCoord.xy, 1.0)));
    float column = 0.5 + (azimuth_rad - atan(away.y, away.x)) / (2.0 * PI);
    float row = acos(clamp(away.z, -1.0, 1.0)) / PI;
    radiance = vec4(textureLod(panorama, vec2(column, row), 0.0).rgb, 1.0);
}
