    incident = @light_call@;
    terms = @model_call@;
    terms = Terms(terms.ambient * incident.e, terms.diffuse * incident.e, terms.specular * incident.e);
    ambient += terms.ambient; diffuse += terms.diffuse; specular += terms.specular;
    total += (terms.ambient + terms.diffuse) + terms.specular;
