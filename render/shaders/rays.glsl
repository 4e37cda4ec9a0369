// The rays of a camera or a light, one for each pixel of the window (render/rays.py).

uniform mat3 start_from_window;
uniform mat3 toward_from_window;

struct Ray {
    vec3 start;
    vec3 toward;    // unit vector, toward where the ray comes from
};

Ray ray_here() {
    vec3 window = vec3(gl_FragCoord.xy, 1.0);
    vec3 toward = toward_from_window * window;
    return Ray(start_from_window * window, toward * inversesqrt(dot(toward, toward)));
}
