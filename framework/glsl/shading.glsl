    vec3 v = normalize(shadelab_eye - x);
    @material@ m = @material@(@members@);
    vec3 ambient = vec3(0), diffuse = vec3(0), specular = vec3(0), total = vec3(0);
    Incident incident;
    Terms terms;
